"""Puts rows with times on a grid of equal steps, and tells how many steps a time lasts."""

from itertools import pairwise
from typing import Final

import numpy as np

from talc.frame import FloatArray, IntArray

HOUR_S: Final = 3600.0
DAY_S: Final = 24.0 * HOUR_S
ABOUT_A_STEP = 0.9
"""Rows at least this fraction of a step apart count as one step each."""
_SAME = 0.005
"""Spacings that differ from the step by less than this are the step, with inexact clocks."""
_FOLLOWED = 0.1
"""Fraction of a row's lateness by which the next rows are expected later: jitter averages out, drift is followed."""


def steps_in(duration_s: float, step_s: float) -> int:
    """The number of grid steps, 1 or more, that last about this long."""
    return max(1, round(duration_s / step_s))


class StepCounter:
    """The grid step of rows that come about a step apart, or further, at any moment of their step, late or early.

    Boundaries at multiples of the step would put two rows into one step and none into the next. Each row is therefore
    one step, and steps are missing where rows are missing.

    Parameters
    ----------
    step_s: grid step
    start_s: time of the first row, s
    k: its step
    """

    def __init__(self, step_s: float, start_s: float, k: int) -> None:
        self.step_s = step_s
        self._due_s, self.k = start_s, k

    def of(self, time_s: FloatArray) -> IntArray:
        """(rows,) steps of the next rows; time_s: (rows,) ascending."""
        index = np.empty(len(time_s), dtype=np.int64)
        for row, at_s in enumerate(time_s.tolist()):
            passed = round((at_s - self._due_s) / self.step_s)
            self.k += passed
            self._due_s += passed * self.step_s
            self._due_s += _FOLLOWED * (at_s - self._due_s)
            index[row] = self.k
        return index


def on_grid(time_s: FloatArray, step_s: float) -> tuple[float, float, IntArray]:
    """The grid's step, s, when the first one ends, s, and (rows,) the step that each row belongs to.

    Rows denser than the grid fall into the steps that end at multiples of `step_s`. Others are a step each
    (`StepCounter`), of their median spacing if that is not about `step_s`. time_s: (rows,) UTC seconds, ascending.
    """
    apart = np.diff(np.unique(time_s))
    spacing_s = float(np.median(apart)) if apart.size else 0.0
    if spacing_s < ABOUT_A_STEP * step_s:
        index: IntArray = np.ceil(time_s / step_s - 1e-9).astype(np.int64)
        return step_s, float(index[0]) * step_s, index
    if abs(spacing_s / step_s - 1.0) > _SAME:
        step_s = spacing_s
    start_s = float(time_s[0])
    return step_s, start_s, StepCounter(step_s, start_s, round(start_s / step_s)).of(time_s)


def means_and_lasts(index: IntArray, inputs: FloatArray, errors: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Rows of the same step as one: (T,) steps, (T, n) means of the inputs, (T, m) the last errors; NaN: no value.

    index: (rows,) step of each row, ascending; inputs: (rows, n); errors: (rows, m).
    """
    k, first = np.unique(index, return_index=True)
    bounds = [*first.tolist(), len(index)]
    means, lasts = np.full((len(k), inputs.shape[1]), np.nan), np.full((len(k), errors.shape[1]), np.nan)
    for row, (a, b) in enumerate(pairwise(bounds)):
        means[row] = _mean(inputs[a:b])
        for e in range(errors.shape[1]):
            known = errors[a:b, e]
            known = known[~np.isnan(known)]
            lasts[row, e] = known[-1] if known.size else np.nan
    return k, means, lasts


def measured_together(inputs: FloatArray, errors: FloatArray) -> dict[int, int]:
    """Inputs that have values in the same few rows as an error, while another input has more: input to error.

    Such an input was most likely measured with the error, and is one too. inputs: (rows, n); errors: (rows, m).
    """
    known, measured = ~np.isnan(inputs), ~np.isnan(errors)
    found: dict[int, int] = {}
    for e, rows in enumerate(measured.T):
        if 0 < rows.sum() <= len(rows) / 2 and known[~rows].any():
            same = np.flatnonzero((known == rows[:, None]).all(axis=0))
            found |= dict.fromkeys(same.tolist(), e)
    return found


def _mean(rows: FloatArray) -> FloatArray:
    known = ~np.isnan(rows)
    count = known.sum(axis=0)
    total = np.where(known, rows, 0.0).sum(axis=0)
    mean: FloatArray = np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0)
    return mean
