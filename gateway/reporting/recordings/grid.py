"""Checks a user's recording (CSV or Parquet) and puts it on the grid: time, inputs, errors with gaps."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.config.problems import Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.reporting.recordings.cells import numbers_of
from gateway.reporting.recordings.chunks import Chunk, FileTable
from gateway.reporting.recordings.columns import Columns, Roles, roles_of, without_companions
from gateway.reporting.recordings.files import open_table
from gateway.reporting.recordings.layout import Unknown
from gateway.reporting.recordings.problems import FileProblems, RecordingError
from gateway.reporting.recordings.times import TimeFormat, Times
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, BoolArray, FloatArray, IntArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.steps import ABOUT_A_STEP, means_and_lasts, measured_together, on_grid
from talc.units import COLUMN_UNITS

_LEAST_STEPS = 12
_LISTED = 5
"""Lines that are named at which a run begins."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Grid steps that contain anything; a step that the file skips is a gap in k."""

    name: str
    """Name of the machine, for the page: the file's, without its suffix."""
    step_s: float
    start_utc_s: float
    """UTC seconds at which the first step ends."""
    k: IntArray
    """(T,) grid index, as a gateway counts: the step that ends at about UTC = k · step_s; ascending."""
    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, n) means over each step; NaN without a value."""
    errors: FloatArray
    """(T, 9) the last measured value in each step, µm and µm/m; NaN without one."""
    labels: tuple[str, ...]
    """(9,) names of the errors: those of the file in places that it does not use otherwise, of the same unit."""
    error_columns: Mapping[str, str]
    """Error to the file's column."""
    ignored: tuple[str, ...]
    """Columns that were left out."""
    sha256: str
    """SHA-256 of the file."""
    origin_s: float | None = None
    """Time of the first row, on the clock of `start_utc_s`, if the file counts time without a date; None: UTC."""
    time_unit: str = "s"
    """Unit in which it counts."""
    notes: tuple[Text, ...] = ()
    """What a reader should know of how the file was read."""
    zero_each_run: bool = False
    """Errors count from the beginning of each run, a new reference."""
    restarts: tuple[int, ...] = ()
    """Of k: steps at which another run begins, an unknown time after the run before it."""


def read_recording(path: Path, columns: Columns, step_s: float) -> Recording:
    """The recording on a grid of `step_s`, or of the file's median spacing if that is about as long or longer.

    Raises RecordingError with every problem: line (row in Parquet), column and value.
    """
    table = open_table(path, columns.layout)
    problems = FileProblems(path)
    roles = roles_of(table.head, columns, problems)
    _refuse(problems, table)
    places = _places(roles, columns, problems)
    problems.refuse()
    clock = columns.clock.named(roles.time)
    times = Times(problems, clock)
    rows = _read(table, roles, columns, times, problems)
    n, notes = len(roles.inputs), [*table.notes, *_of_unit(columns.clock, clock, times)]
    without_companions(measured_together(rows.values[:, :n], rows.values[:, n:]), roles, columns, problems)
    problems.refuse()
    notes += _one_after_another(rows, step_s, table.word)
    rows, note = _once(rows, step_s, table.word, roles.time, times, problems)
    problems.refuse()
    notes += note
    time_s, values = rows.time_s, rows.values
    step_s, start_s, index = on_grid(time_s, step_s)
    k, inputs, errors = means_and_lasts(index, values[:, :n], values[:, n:])
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} {table.word}s fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        what += (
            f"; are the times in {clock.unit or 's'}? --time-unit h is for hours, --time-format excel for Excel's dates"
            if len(time_s) >= _LEAST_STEPS
            else ""
        )
        raise RecordingError(path, [Problem("", what)])
    measured = np.full((len(k), len(THERMAL_ERRORS)), np.nan)
    measured[:, places] = errors
    labels = list(THERMAL_ERRORS)
    for place, error in zip(places, roles.errors, strict=True):
        labels[place] = error
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Recording(
        name=path.stem,
        step_s=step_s,
        start_utc_s=start_s,
        k=k,
        input_names=roles.inputs,
        inputs=inputs,
        errors=measured,
        labels=tuple(labels),
        error_columns=roles.errors,
        ignored=roles.ignored,
        sha256=sha256,
        origin_s=None if times.dated else times.first_s,
        time_unit=clock.unit or "s",
        notes=tuple(notes),
        restarts=tuple(index[rows.restarts].tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _FileRows:
    """What a file holds."""

    time_s: FloatArray
    """(rows,) ascending; equal ones may follow each other."""
    values: FloatArray
    """(rows, inputs and errors)."""
    places: IntArray
    """(rows,) lines."""
    restarts: BoolArray
    """(rows,) another run begins with an earlier time."""


def _one_after_another(rows: _FileRows, step_s: float, word: str) -> list[Text]:
    """Moves each run that begins with an earlier time to the step after the one before it; a remark says so."""
    begins = np.flatnonzero(rows.restarts)
    if not begins.size:
        return []
    apart = np.diff(rows.time_s)[~rows.restarts[1:]]
    apart = apart[apart > 0.0]
    spacing_s = max(step_s, float(np.median(apart)) if apart.size else 0.0)
    for row in begins.tolist():
        rows.time_s[row:] += rows.time_s[row - 1] - rows.time_s[row] + spacing_s
    places = [str(rows.places[row]) for row in begins[:_LISTED].tolist()]
    places += ["..."] if begins.size > _LISTED else []
    return [Text(NoticeCode.RUNS_ONE_AFTER_ANOTHER, n=begins.size + 1, word=word, places=places)]


def _of_unit(given: TimeFormat, clock: TimeFormat, times: Times) -> list[Text]:
    """A remark if the column's name has stated the unit."""
    if given.unit or not clock.unit or clock.unit == "s" or times.dated:
        return []
    return [Text(NoticeCode.TIMES_IN_UNIT, unit=clock.unit)]


def _once(
    rows: _FileRows, step_s: float, word: str, time: str, times: Times, problems: FileProblems
) -> tuple[_FileRows, list[Text]]:
    """Without rows that repeat the one before them. Equal times of other rows matter only if rows are a step each."""
    same = np.flatnonzero(np.diff(rows.time_s) == 0.0) + 1
    if not same.size:
        return rows, []
    equal = np.equal(rows.values[same], rows.values[same - 1])
    equal |= np.isnan(rows.values[same]) & np.isnan(rows.values[same - 1])
    exact = equal.all(axis=1)
    apart = np.diff(np.unique(rows.time_s))
    if apart.size and float(np.median(apart)) >= ABOUT_A_STEP * step_s:
        for row in same[~exact].tolist():
            what = "has the time of the row before it, but other values; give each row a different time"
            problems.add(f"{word} {rows.places[row]}, column {time!r}", what + times.repeated(), "same")
    kept = np.ones(len(rows.time_s), dtype=np.bool_)
    kept[same[exact]] = False
    counts = ((NoticeCode.ROWS_REPEATED, int(exact.sum())), (NoticeCode.ROWS_OF_ONE_TIME, int((~exact).sum())))
    notes = [Text(code, n=n, word=f"{word}s") for code, n in counts if n]
    return _FileRows(rows.time_s[kept], rows.values[kept], rows.places[kept], rows.restarts[kept]), notes


def _refuse(problems: FileProblems, table: FileTable) -> None:
    """Raises RecordingError when there is any problem, with where the table begins if that is not the first line."""
    if problems and (advice := table.advice()):
        problems.add("", advice)
    problems.refuse()


def _places(roles: Roles, columns: Columns, problems: FileProblems) -> list[int]:
    """Which of the controller's nine places each error takes: its own, or a free one of the same unit."""
    places: dict[str, int] = {e: THERMAL_ERRORS.index(e) for e in roles.errors if e in THERMAL_ERRORS}
    for error in roles.errors:
        unit = COLUMN_UNITS[columns.units[error]][0] if error in columns.units else ERROR_UNITS.get(error, MICROMETRE)
        if error in THERMAL_ERRORS:
            if unit != ERROR_UNITS[error]:
                fit = ", ".join(u for u, (kind, _) in COLUMN_UNITS.items() if kind == ERROR_UNITS[error])
                problems.add(
                    f"unit of {error}", f"{columns.units[error]!r} is no unit of {ERROR_UNITS[error]}; expected {fit}"
                )
            continue
        free = [i for i, name in enumerate(THERMAL_ERRORS) if ERROR_UNITS[name] == unit and i not in places.values()]
        if free:
            places[error] = free[0]
        else:
            what = "the controller takes six errors in µm and three in µm/m; talc.rehearse takes any number"
            problems.add(f"error {error}", f"has no place: {what} (docs/library.md)")
    return [places.get(error, 0) for error in roles.errors]


def _read(table: FileTable, roles: Roles, columns: Columns, times: Times, problems: FileProblems) -> _FileRows:
    """All rows, with errors in µm and µm/m. Raises RecordingError."""
    names = (*roles.inputs, *roles.errors.values())
    scale = np.ones(len(names))
    for i, error in enumerate(roles.errors, len(roles.inputs)):
        scale[i] = COLUMN_UNITS[columns.units[error]][1] if error in columns.units else 1.0
    largest = [LARGEST_INPUT] * len(roles.inputs) + [LARGEST_ERROR / x for x in scale[len(roles.inputs) :].tolist()]
    unknown = Unknown(columns.layout.missing)
    others = [name for name in (columns.time_of_day, columns.runs) if name]
    time_s: list[FloatArray] = []
    values: list[FloatArray] = []
    places: list[int] = []
    for chunk in table.chunks(roles.time, (*names, *others), problems):

        def where(name: str, chunk: Chunk = chunk) -> Callable[[int], str]:
            return lambda i: f"{table.word} {chunk.places[i]}, column {name!r}"

        cells, other = chunk.time, dict(zip(others, chunk.columns[len(names) :], strict=True))
        if columns.time_of_day:
            cells = [f"{day} {of_day}" for day, of_day in zip(chunk.time, other[columns.time_of_day], strict=True)]
        time_s.append(times.take(cells, where(roles.time), other.get(columns.runs)))
        places += chunk.places
        read = zip(names, largest, chunk.columns, strict=False)
        found = [numbers_of(cells, name, most, where(name), problems, unknown) for name, most, cells in read]
        values.append(np.column_stack(found))
    _refuse(problems, table)
    if not time_s:
        problems.add("", "contains nothing but a heading")
        return _FileRows(
            np.empty(0), np.empty((0, len(names))), np.empty(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
        )
    restarts = np.zeros(len(places), dtype=np.bool_)
    restarts[times.restarts] = True
    with np.errstate(invalid="ignore"):  # a signalling NaN of a Parquet file is missing, as any other NaN
        return _FileRows(np.concatenate(time_s), np.concatenate(values) * scale, np.array(places), restarts)
