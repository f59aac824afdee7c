"""Checks a user's recording (CSV or Parquet) and puts it on the grid: time, inputs, errors with gaps."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.config import Problem
from gateway.recordings.cells import Times, numbers_of
from gateway.recordings.columns import COLUMN_UNITS, Columns, Roles, roles_of, without_companions
from gateway.recordings.files import Chunk, FileTable, open_table
from gateway.recordings.problems import FileProblems, RecordingError
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, FloatArray, IntArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.steps import means_and_lasts, measured_together, on_grid

_LEAST_STEPS = 12


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
    """Of the file."""
    origin_s: float | None = None
    """Of the first row, on the clock of `start_utc_s`, if the file counts seconds without a date; None: UTC."""


def read_recording(path: Path, columns: Columns, step_s: float) -> Recording:
    """The recording on a grid of `step_s`, or of its own median spacing if that is about as long or longer.

    Raises RecordingError with every problem: line (row in Parquet), column and value.
    """
    table = open_table(path)
    problems = FileProblems(path)
    roles = roles_of(table.head, columns, problems)
    problems.refuse()
    places = _places(roles, columns, problems)
    problems.refuse()
    times = Times(problems, columns.clock)
    time_s, values = _read(table, roles, columns, times, problems)
    n = len(roles.inputs)
    without_companions(measured_together(values[:, :n], values[:, n:]), roles, columns, problems)
    problems.refuse()
    step_s, start_s, index = on_grid(time_s, step_s)
    k, inputs, errors = means_and_lasts(index, values[:, :n], values[:, n:])
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} {table.word}s fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        what += (
            "; are the times in seconds? (Excel's dates: --time-format excel)" if len(time_s) >= _LEAST_STEPS else ""
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
    )


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


def _read(
    table: FileTable, roles: Roles, columns: Columns, times: Times, problems: FileProblems
) -> tuple[FloatArray, FloatArray]:
    """(rows,) s, and (rows, inputs and errors), µm and µm/m."""
    names = (*roles.inputs, *roles.errors.values())
    scale = np.ones(len(names))
    for i, error in enumerate(roles.errors, len(roles.inputs)):
        scale[i] = COLUMN_UNITS[columns.units[error]][1] if error in columns.units else 1.0
    largest = [LARGEST_INPUT] * len(roles.inputs) + [LARGEST_ERROR / x for x in scale[len(roles.inputs) :].tolist()]
    time_s: list[FloatArray] = []
    values: list[FloatArray] = []
    for chunk in table.chunks(roles.time, names, problems):

        def where(name: str, chunk: Chunk = chunk) -> Callable[[int], str]:
            return lambda i: f"{table.word} {chunk.places[i]}, column {name!r}"

        time_s.append(times.take(chunk.time, where(roles.time)))
        read = zip(names, largest, chunk.columns, strict=True)
        values.append(np.column_stack([numbers_of(cells, most, where(name), problems) for name, most, cells in read]))
    problems.refuse()
    if not time_s:
        problems.add("", "contains nothing but a heading")
        return np.empty(0), np.empty((0, len(names)))
    return np.concatenate(time_s), np.concatenate(values) * scale
