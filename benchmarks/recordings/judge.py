"""Measurements at the same times for all methods, and the residuals, judged before a row's own measurement."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.recordings.methods import Method, MethodCourse, given_of
from benchmarks.recordings.series import Series
from talc.frame import BoolArray, FloatArray
from talc.indicators import TWO_SIDED_95, Spread, first_hour_apart, rms

FIRST_HOURS = (0.0, 2.0, 6.0, 24.0, np.inf)
"""Edges of the learning curve's windows, in hours since the beginning."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of all errors of one unit together, in that unit."""

    rms: float
    p99: float
    largest: float
    inside: float
    """Share of the recorded values inside the 95 % interval; NaN: no interval was stated."""
    curve: tuple[float, ...]
    """RMSE divided by that of no compensation in each window of FIRST_HOURS; NaN: no row there."""
    by_error: tuple[float, ...]
    """RMSE of each error."""
    first_hour: Spread
    later: Spread
    """The first hour after the beginning, and the rest: the largest E_PV of any error, and RMSE."""


def rows_to_measure(series: Series, dense_h: float, interval_min: float, measure_first: bool = True) -> BoolArray:
    """(T,) rows with a measurement: each row of the first hours, then one an interval, and at the beginning of a run.

    Rows without any recorded error wait for the next one that has one. Hours off do not count as beginning.
    """
    used = np.zeros(len(series.k), dtype=np.bool_)
    dense = [bool(hour < dense_h) for hour in series.on_h]
    available = [bool(known.any()) for known in np.isfinite(series.truth)]
    steps = steps_of(interval_min, series.step_s)
    last: int | None = None
    run = -1
    for row, k in enumerate(series.k.tolist()):
        begins = measure_first and int(series.run[row]) != run
        if available[row] and (last is None or dense[row] or begins or k - last >= steps):
            used[row], last, run = True, k, int(series.run[row])
    return used


def steps_of(interval_min: float, step_s: float) -> int:
    """Grid steps of an interval, at least one."""
    return max(round(interval_min * 60.0 / step_s), 1)


def apply_method(
    method: Method, series: Series, used: BoolArray, seed: int, dense_h: float, interval_min: float
) -> MethodCourse | None:
    """The method's course; if it has several, the one with the smallest residual. None: it cannot start from this."""
    dense_steps = round(dense_h * 3600.0 / series.step_s)
    given = given_of(series, used, seed, dense_steps, steps_of(interval_min, series.step_s))
    courses = method.courses(given)
    return min(courses, key=lambda course: _left(series, course, dense_h)) if courses else None


def _left(series: Series, course: MethodCourse, dense_h: float) -> float:
    """RMS in units of each error's own swing, so that µm and µm/m count alike."""
    after = series.on_h >= dense_h
    left = residual(series, course)[after]
    swing = np.maximum(np.nanstd(series.truth, axis=0), 1e-9)
    return float(np.sqrt(np.nanmean((left / swing) ** 2)))


def residual(series: Series, course: MethodCourse) -> FloatArray:
    """(T, m) the residual; without an estimate nothing is corrected."""
    return series.truth - np.where(np.isfinite(course.estimate), course.estimate, 0.0)


def judge_course(series: Series, course: MethodCourse, dense_h: float, errors: Sequence[int]) -> Figures:
    """Figures of some errors over all rows after the dense beginning in which they were recorded."""
    chosen = list(errors)
    after = series.on_h >= dense_h
    truth = series.truth[:, chosen]
    left = residual(series, course)[:, chosen]
    judged = np.abs(left[after])
    known = judged[np.isfinite(judged)]
    hours = series.on_h
    first_hour, later = first_hour_apart((hours[after] - dense_h) * 3600.0, left[after])
    curve = tuple(
        _over(left[window], truth[window]) for a, b in pairwise(FIRST_HOURS) for window in [(hours >= a) & (hours < b)]
    )
    return Figures(
        rms=rms(known),
        p99=float(np.quantile(known, 0.99)) if known.size else np.nan,
        largest=float(known.max()) if known.size else np.nan,
        inside=coverage(left[after], course.sigma[after][:, chosen], series.noise[chosen]),
        curve=curve,
        by_error=tuple(rms(e) for e in left[after].T),
        first_hour=first_hour,
        later=later,
    )


def coverage(left: FloatArray, sigma: FloatArray, noise: FloatArray) -> float:
    """Share of recorded values inside the 95 % interval of what is recorded: the truth's with the recording's noise."""
    stated = np.isfinite(sigma) & np.isfinite(left)
    if not stated.any():
        return float("nan")
    inside = np.abs(left) <= TWO_SIDED_95 * np.hypot(sigma, noise)
    return float(inside[stated].mean())


def _over(left: FloatArray, truth: FloatArray) -> float:
    known = np.isfinite(truth)
    without = rms(truth[known])
    return rms(left[known]) / without if without > 0 else float("nan")
