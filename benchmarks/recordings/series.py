"""A recording on the grid: inputs, errors in µm and µm/m, runs, and the true time between them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.recordings.description import Description, InputColumn, description_of
from gateway.config.problems import ConfigError, Problem, shown, suggestion
from gateway.reporting.recordings.chunks import FileTable
from gateway.reporting.recordings.files import open_table
from gateway.reporting.recordings.layout import TextLayout, Unknown
from gateway.reporting.recordings.problems import FileProblems, RecordingError
from gateway.reporting.recordings.times import TIME_UNITS, forms_of, second_of
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, BoolArray, FloatArray, IntArray
from talc.learner.plausible import strange_cells
from talc.units import named_unit

_NUMERIC = 0.5
"""Share of a column's cells that must be numbers for it to be an input without being named."""
_LEAST_STEPS = 24
_GUESSED_FROM = 50
"""Cells from which the form of dates is guessed."""
_SPACED = 1.1
"""A recording spaced wider than the grid by more than this keeps its own spacing."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """T grid steps that contain any values."""

    name: str
    step_s: float
    k: IntArray
    """(T,) grid index, ascending; missing steps were not recorded."""
    run: IntArray
    """(T,) number of the run, from 0."""
    input_names: tuple[str, ...]
    about: tuple[InputColumn, ...]
    """The description of each input."""
    inputs: FloatArray
    """(T, n); NaN without a value."""
    error_names: tuple[str, ...]
    units: tuple[str, ...]
    """(m,) in which each error was read, of talc.units.COLUMN_UNITS."""
    angle: BoolArray
    """(m,) in µm/m, not in µm."""
    truth: FloatArray
    """(T, m) as recorded, µm or µm/m, from the reference; NaN without a value."""
    noise: FloatArray
    """(m,) standard deviation of the recorded values' own noise."""
    probing: FloatArray
    """(m,) standard deviation of the noise added to a measurement."""
    notes: tuple[str, ...]
    """Remarks from reading the file."""
    zero_each_run: bool = False
    """Errors count from a new reference in each run."""

    @property
    def on_h(self) -> FloatArray:
        """(T,) recorded hours since the beginning, not counting the time between runs."""
        return np.asarray(steps_on(self.k, self.run) * self.step_s / 3600.0, dtype=np.float64)

    @property
    def units_read(self) -> str:
        """`read in mm`; if they differ, `read dx, dy in mm; pitch in arcsec`."""
        by_unit: dict[str, list[str]] = {}
        for name, unit in zip(self.error_names, self.units, strict=True):
            by_unit.setdefault(f"in {unit.replace('um', 'µm').replace('urad', 'µrad')}", []).append(name)
        if len(by_unit) == 1:
            return f"read {next(iter(by_unit))}"
        return "read " + "; ".join(f"{', '.join(names)} {unit}" for unit, names in by_unit.items())


def steps_on(k: IntArray, run: IntArray) -> IntArray:
    """(T,) grid steps since the beginning, not counting those between runs."""
    steps = np.diff(k, prepend=k[0])
    steps[1:][np.diff(run) != 0] = 1
    return np.asarray(np.cumsum(steps))


def read_series(description: Path) -> tuple[Description, Series]:
    """The recording that a TOML file describes. ConfigError or RecordingError names file, place and value."""
    said, path = description_of(description)
    table, problems = open_table(path, TextLayout(said.skipped, said.missing)), FileProblems(path)
    inputs, strange_kinds = _plain(table, _roles(table.head, said, description), said.time.column, path)
    wanted = [said.time.column, *said.errors, *inputs]
    if said.runs.column is not None:
        wanted.append(said.runs.column)
    columns, places = _cells(table, wanted, problems)
    time_s, run = _times(columns, places, table.word, said, description, problems)
    problems.refuse()
    notes = [*table.notes, *(f"column {name!r}: does not contain numbers; left out" for name in strange_kinds)]
    notes += [
        f"column {name!r}: its name says {named_unit(name)}, read in {said.unit_of(name)}, as the file says"
        for name in said.errors
        if named_unit(name) not in ("", said.unit_of(name))
    ]
    unknown = Unknown(said.missing)
    errors = [
        _values(columns[e], e, said.scale_of(e), LARGEST_ERROR, table, places, problems, unknown) for e in said.errors
    ]
    problems.refuse()
    kept, read = [], []
    for name in inputs:
        values, strange = _tolerant(columns[name], unknown)
        if np.isfinite(values).mean() < _NUMERIC and strange:
            notes.append(f"column {name!r}: {strange} of {len(values)} cells are not numbers; left out")
            continue
        if not np.isfinite(values).any():
            notes.append(f"column {name!r}: empty; left out")
            continue
        if strange:
            notes.append(f"column {name!r}: {strange} cells are not numbers; taken as missing")
        kept.append(name)
        read.append(values)
    if not kept:
        raise ConfigError(description, [Problem("inputs", f"no column of numbers remains as an input in {path.name}")])
    return said, _gridded(said, description, time_s, run, errors, kept, read, notes)


def _gridded(
    said: Description,
    description: Path,
    time_s: FloatArray,
    run: IntArray,
    errors: Sequence[FloatArray],
    kept: Sequence[str],
    read: Sequence[FloatArray],
    notes: list[str],
) -> Series:
    """Rows averaged, or the last of each taken, over steps."""
    step_s = said.step_s
    within = np.diff(time_s)[np.diff(run) == 0]
    spacing_s = float(np.median(within)) if within.size else 0.0
    if spacing_s > _SPACED * step_s:
        notes.append(f"rows are {spacing_s:g} s apart: that is the grid's step instead of {step_s:g} s")
        step_s = spacing_s
    index = np.ceil((time_s - time_s[0]) / step_s - 1e-6).astype(np.int64)
    # Two runs never share a step: the later one begins with the next.
    for row in np.flatnonzero(np.diff(run)) + 1:
        late = index[row - 1] + 1 - index[row]
        if late > 0:
            index[row:] += late
    k, first = np.unique(index, return_index=True)
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} rows fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        raise ConfigError(description, [Problem("time", f"{what}; are the times in {said.time.unit}?")])
    bounds = [*first.tolist(), len(index)]
    put = _mean if said.sampling == "mean" else _last
    on_grid = np.array([put(np.column_stack(read)[a:b]) for a, b in pairwise(bounds)])
    truth = np.array([put(np.column_stack(errors)[a:b]) for a, b in pairwise(bounds)])
    for e, name in enumerate(said.errors):
        known = truth[np.isfinite(truth[:, e]), e]
        if not known.size:
            raise ConfigError(description, [Problem(f"errors, {name!r}", "has no value in any row")])
        if said.reference == "first":
            truth[:, e] -= known[0]
        elif said.reference == "run":
            _zero_each_run(truth[:, e], run[first])
    notes += _no_values(kept, on_grid, k, step_s)
    return Series(
        name=said.name or description.stem,
        step_s=step_s,
        k=k - k[0],
        run=run[first] - run[0],
        input_names=tuple(kept),
        about=tuple(said.input_of(name) or InputColumn() for name in kept),
        inputs=on_grid,
        error_names=tuple(said.errors),
        units=tuple(said.unit_of(e) for e in said.errors),
        angle=np.array([said.is_angle(e) for e in said.errors]),
        truth=truth,
        noise=np.array([said.noise_of(e) for e in said.errors]),
        probing=np.array([said.probing_of(e) for e in said.errors]),
        notes=tuple(notes),
        zero_each_run=said.reference == "run",
    )


def _zero_each_run(truth: FloatArray, run: IntArray) -> None:
    """(T,) one error, from its first value in each run; in place."""
    for rows in (run == number for number in np.unique(run)):
        known = truth[rows & np.isfinite(truth)]
        truth[rows] -= known[0] if known.size else 0.0


def _no_values(names: Sequence[str], inputs: FloatArray, k: IntArray, step_s: float) -> list[str]:
    """Notes on cells that a fault has made."""
    notes = []
    for cells in strange_cells(names, inputs, k, step_s):
        with_other = f" with {cells.other!r}" if cells.other != cells.input else ""
        where = f"{cells.count} steps, from {(k[cells.first] - k[0]) * step_s / 3600.0:.1f} h on"
        notes.append(f"column {cells.input!r}: no value of it in {where}: {cells.fault.value}{with_other}")
    return notes


def _roles(head: Sequence[str], said: Description, description: Path) -> list[str]:
    """The columns that may be inputs. ConfigError: a named column that the table does not have."""
    problems = []
    named = [("time, column", said.time.column), *(("errors", name) for name in said.errors)]
    if said.runs.column is not None:
        named.append(("runs, column", said.runs.column))
    named += [("inputs", name) for name in said.inputs if not set("*?[") & set(name)]
    for field, name in named:
        if name not in head:
            problems.append(Problem(field, f"the recording has no column {name!r}; {suggestion(name, head)}"))
    twice = sorted({name for name in head if name and list(head).count(name) > 1})
    if twice:
        problems.append(Problem("", f"the recording's column {twice[0]!r} occurs twice"))
    if problems:
        raise ConfigError(description, problems)
    used = {said.time.column, said.runs.column, *said.errors, ""}
    return [name for name in head if name not in used and not said.ignores(name) and said.input_of(name) is not None]


def _plain(table: FileTable, names: Sequence[str], time: str, path: Path) -> tuple[list[str], list[str]]:
    """Columns whose type can be read as numbers, and those that cannot (Parquet has types, CSV has none)."""
    if table.word != "row":
        return list(names), []
    plain, others = [], []
    for name in names:
        found = FileProblems(path)
        next(iter(table.chunks(time, [name], found)), None)
        try:
            found.refuse()
        except RecordingError:
            others.append(name)
        else:
            plain.append(name)
    return plain, others


def _cells(
    table: FileTable, wanted: Sequence[str], problems: FileProblems
) -> tuple[dict[str, list[object]], list[int]]:
    """Cells by column, and the line or row of each."""
    time, *others = wanted
    columns: dict[str, list[object]] = {name: [] for name in wanted}
    places: list[int] = []
    for chunk in table.chunks(time, others, problems):
        places += chunk.places
        columns[time] += chunk.time
        for name, cells in zip(others, chunk.columns, strict=True):
            columns[name] += cells
    if not places:
        problems.add("", "contains nothing but a heading")
    problems.refuse()
    return columns, places


def _times(
    columns: dict[str, list[object]],
    places: Sequence[int],
    word: str,
    said: Description,
    description: Path,
    problems: FileProblems,
) -> tuple[FloatArray, IntArray]:
    """(rows,) s, ascending over all runs, and (rows,) the number of the run."""
    cells = columns[said.time.column]
    time_s = np.array([_time(cell, said) for cell in cells])
    fitting = forms_of(str(cell) for cell in cells[:_GUESSED_FROM]) if np.isnan(time_s).any() else []
    for i in np.flatnonzero(np.isnan(time_s)).tolist():
        expected = f"expected {said.time.format!r}" if said.time.format else "expected ISO 8601 or a number"
        forms = " or ".join(f"format = {form!r}" for form in fitting)
        expected += f"; [time] {forms} reads this one" if forms else ""
        where = f"{word} {places[i]}, column {said.time.column!r}"
        problems.add(where, f"{shown(cells[i])} is not a time; {expected}", "time")
    problems.refuse()
    begins = np.zeros(len(cells), dtype=np.bool_)
    if said.runs.column is not None:
        marks = columns[said.runs.column]
        begins[1:] = [a != b for a, b in pairwise(marks)]
    back = np.diff(time_s, prepend=time_s[0]) < 0
    for i in np.flatnonzero(back & ~begins).tolist():
        what = f"{shown(cells[i])} comes before {shown(cells[i - 1])} of the row above"
        hint = "sort the rows, or name the column that distinguishes runs ([runs] column)"
        problems.add(f"{word} {places[i]}, column {said.time.column!r}", f"{what}; {hint}")
    problems.refuse()
    restarts = np.flatnonzero(back & begins)
    off = said.runs.off_h
    if restarts.size and off is None:
        what = f"missing: time starts again at {word} {places[restarts[0]]}, so the hours off before it are unknown"
        raise ConfigError(description, [Problem("[runs] off_h", what)])
    hours = off if isinstance(off, tuple) else (off or 0.0,) * int(restarts.size)
    if len(hours) != restarts.size and restarts.size:
        what = f"has {len(hours)} entries; time starts again {restarts.size} times"
        raise ConfigError(description, [Problem("[runs] off_h", what)])
    for i, gap_h in zip(restarts.tolist(), hours, strict=False):
        time_s[i:] += time_s[i - 1] - time_s[i] + gap_h * 3600.0
    begins[1:] |= np.diff(time_s) > said.runs.gap_min * 60.0
    return time_s, np.cumsum(begins).astype(np.int64)


def _time(cell: object, said: Description) -> float:
    """Seconds; NaN: no time."""
    if said.time.format is not None and isinstance(cell, str):
        try:
            found = datetime.strptime(cell, said.time.format)  # noqa: DTZ007 - a time without a zone is UTC
        except ValueError:
            return math.nan
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    plain = _number(cell)
    if plain is not None:
        return plain * TIME_UNITS[said.time.unit]
    second = second_of(cell)
    return math.nan if second is None else second


def _number(cell: object) -> float | None:
    """None: not a finite number."""
    if isinstance(cell, bool):
        return float(cell)
    if isinstance(cell, int | float | str):
        try:
            value = float(cell)
        except (ValueError, OverflowError):
            return None
        return value if math.isfinite(value) else None
    return None


def _tolerant(cells: Sequence[object], unknown: Unknown) -> tuple[FloatArray, int]:
    """(rows,) NaN where there is no number, and how many of those are not simply missing."""
    found, strange = np.full(len(cells), np.nan), 0
    for i, cell in enumerate(cells):
        value = _number(cell)
        if value is not None and abs(value) <= LARGEST_INPUT:
            found[i] = value
        elif not unknown.is_word(cell):
            strange += 1
    return unknown.without_numbers(found), strange


def _values(
    cells: Sequence[object],
    name: str,
    scale: float,
    largest: float,
    table: FileTable,
    places: Sequence[int],
    problems: FileProblems,
    unknown: Unknown,
) -> FloatArray:
    """(rows,) an error, µm or µm/m; NaN where it was not measured."""
    found = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        value = _number(cell)
        where = f"{table.word} {places[i]}, column {name!r}"
        if value is None:
            if not unknown.is_word(cell):
                what = f"{shown(cell)} is not a number; leave an unknown error empty, or name the cell in `missing`"
                problems.add(where, what, f"number {name}")
        elif unknown.is_number(value):
            continue
        elif abs(value * scale) > largest:
            problems.add(where, f"{shown(cell)} is beyond {largest / scale:g}; is its unit right?")
        else:
            found[i] = value * scale
    return found


def _mean(rows: FloatArray) -> FloatArray:
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    total = np.where(known, rows, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0), dtype=np.float64)


def _last(rows: FloatArray) -> FloatArray:
    found = np.full(rows.shape[1], np.nan)
    for row in rows:
        found = np.where(np.isfinite(row), row, found)
    return found
