"""Checks a user's recording (CSV or Parquet) and puts it on the grid: time, inputs, errors with gaps."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gateway.config import Problem
from gateway.recordings.cells import Times, numbers
from gateway.recordings.columns import Columns, Roles, roles_of
from gateway.recordings.files import Chunk, FileTable, open_table
from gateway.recordings.problems import FileProblems, RecordingError
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, FloatArray, IntArray
from talc.names import THERMAL_ERRORS
from talc.steps import means_and_lasts, on_grid

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
    error_columns: Mapping[str, str]
    """Thermal error to the file's column."""
    ignored: tuple[str, ...]
    """Columns that were left out."""
    sha256: str
    """Of the file."""


def read_recording(path: Path, columns: Columns, step_s: float) -> Recording:
    """The recording on a grid of `step_s`, or of its own median spacing if that is about as long or longer.

    Raises RecordingError with every problem: line (row in Parquet), column and value.
    """
    table = open_table(path)
    problems = FileProblems(path)
    roles = roles_of(table.head, columns, problems)
    problems.refuse()
    time_s, values = _read(table, roles, problems)
    problems.refuse()
    step_s, start_s, index = on_grid(time_s, step_s)
    n, places = len(roles.inputs), [THERMAL_ERRORS.index(error) for error in roles.errors]
    k, inputs, errors = means_and_lasts(index, values[:, :n], values[:, n:])
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} {table.word}s fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        what += "; are the times in seconds?" if len(time_s) >= _LEAST_STEPS else ""
        raise RecordingError(path, [Problem("", what)])
    measured = np.full((len(k), len(THERMAL_ERRORS)), np.nan)
    measured[:, places] = errors
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
        error_columns=roles.errors,
        ignored=roles.ignored,
        sha256=sha256,
    )


def _read(table: FileTable, roles: Roles, problems: FileProblems) -> tuple[FloatArray, FloatArray]:
    """(rows,) s, and (rows, inputs and errors)."""
    names = (*roles.inputs, *roles.errors.values())
    largest = [LARGEST_INPUT] * len(roles.inputs) + [LARGEST_ERROR] * len(roles.errors)
    times = Times(problems)
    time_s: list[FloatArray] = []
    values: list[FloatArray] = []
    for chunk in table.chunks(roles.time, names, problems):

        def where(name: str, chunk: Chunk = chunk) -> Callable[[int], str]:
            return lambda i: f"{table.word} {chunk.places[i]}, column {name!r}"

        time_s.append(times.take(chunk.time, where(roles.time)))
        read = zip(names, largest, chunk.columns, strict=True)
        values.append(np.column_stack([numbers(cells, most, where(name), problems) for name, most, cells in read]))
    problems.refuse()
    if not time_s:
        problems.add("", "contains nothing but a heading")
        return np.empty(0), np.empty((0, len(names)))
    return np.concatenate(time_s), np.concatenate(values)
