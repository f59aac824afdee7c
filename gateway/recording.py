"""A user's own recording, CSV or Parquet, checked and put on the grid: time, input columns, error columns with gaps."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from gateway.config.problems import Problem, shown, suggestion
from talc.frame import FloatArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

_SHOWN = 10
"""Problems that are told one by one."""
_LEAST_STEPS = 12
_PARQUET = b"PAR1"
_SQLITE = b"SQLite format 3\0"


class RecordingError(Exception):
    """The recording cannot be used. The text has one line per problem, each beginning with the file's name."""

    def __init__(self, file: Path, problems: Sequence[Problem]) -> None:
        told = [f"{file}: {problem}" for problem in problems[:_SHOWN]]
        if len(problems) > _SHOWN:
            told.append(f"{file}: and {len(problems) - _SHOWN} more")
        super().__init__("\n".join(told))


@dataclass(frozen=True, slots=True)
class Columns:
    """What the file's columns are. An error's own name, or with its unit (`EX0C_um`), is found without being told."""

    time: str = "time"
    errors: Mapping[str, str] | None = None
    """Thermal error to column."""
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Grid steps with anything in them; a step that the file passes over is a gap in k."""

    name: str
    step_s: float
    k: np.ndarray[tuple[int], np.dtype[np.int64]]
    """(T,) grid index, as a gateway counts: the step that ends at UTC = k · step_s; ascending."""
    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, n) means over each step; NaN without a value."""
    errors: FloatArray
    """(T, 9) the last measured value in each step, µm and µm/m; NaN without one."""


@dataclass(frozen=True, slots=True)
class _Raw:
    """Columns as the file has them."""

    columns: dict[str, list[object]]
    places: list[int]
    """Line, or row, of each entry."""
    word: str
    """`line` or `row`."""


def is_database(path: Path) -> bool:
    """Whether the file is a gateway's store."""
    with path.open("rb") as file:
        return file.read(len(_SQLITE)) == _SQLITE


def read_recording(path: Path, columns: Columns, step_s: float) -> Recording:
    """The recording on a grid of `step_s`, or of its own median spacing where that is longer.

    RecordingError tells every problem with line (row in Parquet), column and value.
    """
    with path.open("rb") as file:
        parquet = file.read(len(_PARQUET)) == _PARQUET
    raw = _read_parquet(path) if parquet else _read_csv(path)
    errors, inputs = _roles(path, list(raw.columns), columns)
    problems: list[Problem] = []
    time_s = _times(raw, columns.time, problems)
    chosen = [_numbers(raw, name, problems) for name in (*inputs, *errors.values())]
    if problems:
        raise RecordingError(path, problems)
    step_s = max(step_s, float(np.median(np.diff(time_s)))) if len(time_s) > 1 else step_s
    values = np.column_stack(chosen)
    index = np.ceil(time_s / step_s - 1e-9).astype(np.int64)
    k, first = np.unique(index, return_index=True)
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} {raw.word}s fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        raise RecordingError(path, [Problem("", what)])
    bounds = [*first.tolist(), len(index)]
    n = len(inputs)
    on_grid = np.array([_mean(values[a:b, :n]) for a, b in pairwise(bounds)])
    measured = np.full((len(k), len(THERMAL_ERRORS)), np.nan)
    for column, error in enumerate(errors):
        e = THERMAL_ERRORS.index(error)
        for row, (a, b) in enumerate(pairwise(bounds)):
            known = values[a:b, n + column]
            known = known[~np.isnan(known)]
            measured[row, e] = known[-1] if known.size else np.nan
    return Recording(path.stem, step_s, k, tuple(inputs), on_grid, measured)


def _mean(rows: FloatArray) -> FloatArray:
    known = ~np.isnan(rows)
    count = known.sum(axis=0)
    total = np.where(known, rows, 0.0).sum(axis=0)
    mean: FloatArray = np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0)
    return mean


def _read_csv(path: Path) -> _Raw:
    """Comma, semicolon (then with a decimal comma too) or tab, whichever the heading holds most of."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        what = f"is neither Parquet nor UTF-8 text: byte {error.start} is {error.object[error.start]:#04x}"
        raise RecordingError(path, [Problem("", what)]) from None
    heading = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=heading.count)
    reader = csv.reader(text.splitlines(keepends=True), delimiter=delimiter)
    head = [name.strip() for name in next(reader, [])]
    if not any(head):
        raise RecordingError(path, [Problem("", "is empty; expected a heading and lines below it")])
    problems = [
        Problem(f"column {number + 1}", "has no name" if not name else f"{name!r} occurs twice")
        for number, name in enumerate(head)
        if not name or name in head[:number]
    ]
    rows, places = [], []
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(head):
            problems.append(Problem(f"line {reader.line_num}", f"{len(row)} cells; the heading has {len(head)}"))
        rows.append([cell.strip() for cell in row])
        places.append(reader.line_num)
    if problems:
        raise RecordingError(path, problems)
    comma = delimiter == ";"
    columns: dict[str, list[object]] = {
        name: [row[i].replace(",", ".") if comma else row[i] for row in rows] for i, name in enumerate(head)
    }
    return _Raw(columns, places, "line")


def _read_parquet(path: Path) -> _Raw:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        what = "Parquet needs pyarrow: install talc-gateway with the extra `parquet`, or save the table as CSV"
        raise RecordingError(path, [Problem("", what)]) from None
    try:
        table = parquet.read_table(path)
    except (ArrowException, OSError) as error:
        raise RecordingError(path, [Problem("", f"is not a Parquet file that can be read: {error}")]) from None
    columns = {name: table.column(i).to_pylist() for i, name in enumerate(table.column_names)}
    if len(columns) != len(table.column_names):
        raise RecordingError(path, [Problem("", "a column's name occurs twice")])
    return _Raw(columns, list(range(1, table.num_rows + 1)), "row")


def _roles(path: Path, head: list[str], columns: Columns) -> tuple[dict[str, str], list[str]]:
    """Thermal error to its column, and the input columns."""
    errors = dict(columns.errors or {})
    problems = []
    if columns.time not in head:
        problems.append(Problem(f"column {columns.time!r}", f"is missing (time); {suggestion(columns.time, head)}"))
    problems += [
        Problem(f"column {name!r}", f"is missing; {suggestion(name, head)}")
        for name in (*errors.values(), *columns.ignored)
        if name not in head
    ]
    for error in THERMAL_ERRORS:
        suffix = "_um" if ERROR_UNITS[error] == MICROMETRE else "_um_per_m"
        found = [name for name in (error, error + suffix) if name in head and name not in columns.ignored]
        if found:
            errors.setdefault(error, found[0])
    taken = {columns.time, *errors.values(), *columns.ignored}
    inputs = [name for name in head if name not in taken]
    if not errors:
        what = f"no column of a thermal error; expected one or more of {', '.join(THERMAL_ERRORS)}, or say which it is"
        problems.append(Problem("", what))
    if not inputs:
        problems.append(Problem("", "no column is left as an input"))
    if problems:
        raise RecordingError(path, problems)
    return errors, inputs


def _times(raw: _Raw, name: str, problems: list[Problem]) -> FloatArray:
    """(rows,) s."""
    found = np.full(len(raw.places), np.nan)
    before: tuple[float, object] | None = None
    for i, (place, cell) in enumerate(zip(raw.places, raw.columns[name], strict=True)):
        second = _second(cell)
        where = f"{raw.word} {place}, column {name!r}"
        if second is None:
            problems.append(Problem(where, f"{shown(cell)} is no time; expected ISO 8601 or seconds"))
            continue
        if before is not None and second <= before[0]:
            problems.append(Problem(where, f"{shown(cell)} does not come after {shown(before[1])} before it"))
        before = second, cell
        found[i] = second
    if not raw.places:
        problems.append(Problem("", "holds a heading and nothing else"))
    return found


def _second(cell: object) -> float | None:
    """UTC seconds; a time without a zone is UTC."""
    if isinstance(cell, str):
        try:
            cell = float(cell)
        except ValueError:
            cell = _iso(str(cell))
    if isinstance(cell, datetime):
        return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
    if isinstance(cell, int | float) and not isinstance(cell, bool) and math.isfinite(cell):
        return float(cell)
    return None


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _numbers(raw: _Raw, name: str, problems: list[Problem]) -> FloatArray:
    """(rows,) NaN where the cell is empty or says `nan`."""
    return np.array(list(_each_number(raw, name, problems)), dtype=np.float64)


def _each_number(raw: _Raw, name: str, problems: list[Problem]) -> Iterable[float]:
    for place, cell in zip(raw.places, raw.columns[name], strict=True):
        value = math.nan
        if cell is not None and cell != "":
            try:
                value = float(cell) if isinstance(cell, int | float | str) else math.inf
            except ValueError:
                value = math.inf
        if math.isinf(value):
            where = f"{raw.word} {place}, column {name!r}"
            problems.append(Problem(where, f"{shown(cell)} is no finite number; an unknown value is left empty"))
        yield value
