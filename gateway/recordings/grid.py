"""Checks a user's recording (CSV or Parquet) and puts it on the grid: time, inputs, errors with gaps."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from gateway.config import Problem
from gateway.recordings.cells import Times, numbers
from gateway.recordings.columns import Columns, Roles, roles_of
from gateway.recordings.files import Chunk, FileTable, open_table
from gateway.recordings.problems import FileProblems, RecordingError
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, FloatArray, IntArray
from talc.names import THERMAL_ERRORS

_LEAST_STEPS = 12
_ABOUT = 0.9
"""Rows at least this fraction of a step apart count as one step each."""
_SAME = 0.005
"""Spacings that differ from the step by less than this are the step, with inexact clocks."""
_FOLLOWED = 0.1
"""Fraction of a row's lateness by which the next rows are expected later: jitter averages out, drift is followed."""


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
    step_s, start_s, index = _on_grid(time_s, step_s)
    k, first = np.unique(index, return_index=True)
    if len(k) < _LEAST_STEPS:
        what = f"{len(time_s)} {table.word}s fill {len(k)} steps of {step_s:g} s; expected {_LEAST_STEPS} or more"
        what += "; are the times in seconds?" if len(time_s) >= _LEAST_STEPS else ""
        raise RecordingError(path, [Problem("", what)])
    bounds = [*first.tolist(), len(index)]
    n = len(roles.inputs)
    on_grid = np.array([_mean(values[a:b, :n]) for a, b in pairwise(bounds)])
    measured = np.full((len(k), len(THERMAL_ERRORS)), np.nan)
    for column, error in enumerate(roles.errors):
        e = THERMAL_ERRORS.index(error)
        for row, (a, b) in enumerate(pairwise(bounds)):
            known = values[a:b, n + column]
            known = known[~np.isnan(known)]
            measured[row, e] = known[-1] if known.size else np.nan
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Recording(
        name=path.stem,
        step_s=step_s,
        start_utc_s=start_s,
        k=k,
        input_names=roles.inputs,
        inputs=on_grid,
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


def _on_grid(time_s: FloatArray, step_s: float) -> tuple[float, float, IntArray]:
    """The grid's step, s, when the first one ends, s, and (rows,) the step that each row belongs to.

    Rows denser than the grid fall into the steps that end at multiples of `step_s`. Rows about a step apart come at any
    moment of their step, late or early: boundaries at multiples of the step would put two rows into one and none into
    the next. Each is therefore a step of its own, and steps are missing where rows are missing.
    """
    spacing_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    if spacing_s < _ABOUT * step_s:
        index: IntArray = np.ceil(time_s / step_s - 1e-9).astype(np.int64)
        return step_s, float(index[0]) * step_s, index
    if abs(spacing_s / step_s - 1.0) > _SAME:
        step_s = spacing_s
    due_s, k = float(time_s[0]), round(float(time_s[0]) / step_s)
    index = np.empty(len(time_s), dtype=np.int64)
    for row, at_s in enumerate(time_s.tolist()):
        passed = round((at_s - due_s) / step_s)
        k += passed
        due_s += passed * step_s
        due_s += _FOLLOWED * (at_s - due_s)
        index[row] = k
    return step_s, float(time_s[0]), index


def _mean(rows: FloatArray) -> FloatArray:
    known = ~np.isnan(rows)
    count = known.sum(axis=0)
    total = np.where(known, rows, 0.0).sum(axis=0)
    mean: FloatArray = np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0)
    return mean
