"""Policies compared with a fixed interval: how many measurements they need for equal errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from benchmarks.recordings.judge import Figures, apply_method, judge_course, rows_to_measure
from benchmarks.recordings.methods import Given, Method, MethodCourse, given_of
from benchmarks.recordings.series import Series
from talc.frame import BoolArray, FloatArray

LIMITS_UM = (2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Limits that are swept; µm/m in proportion."""
FIXED_MIN = (20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 240.0, 360.0, 480.0, 720.0)
"""Fixed intervals that are swept."""


@runtime_checkable
class Deciding(Method, Protocol):
    """A method that decides itself when to measure."""

    def decide(self, given: Given, limit: float) -> tuple[MethodCourse, BoolArray]:
        """Its course and the rows in which it measured, from a record of measurements in all rows.

        limit: the largest half-width of its 95 % interval, µm or µm/m.
        """
        ...


@dataclass(frozen=True, slots=True)
class Point:
    """One way to measure."""

    what: str
    """The limit, or the interval."""
    measurements: int
    """After the beginning."""
    rms: float
    p99: float
    inside: float


@dataclass(frozen=True, slots=True)
class Saving:
    """A policy's measurements over a fixed interval's at equal errors; NaN: beyond the intervals that were run."""

    point: Point
    at_equal_rms: float
    at_equal_p99: float


def point_of(
    what: str, series: Series, course: MethodCourse, used: BoolArray, dense_h: float, errors: Sequence[int]
) -> Point:
    """The result of one way, after the beginning."""
    found: Figures = judge_course(series, course, dense_h, errors)
    return Point(what, int(used[series.on_h >= dense_h].sum()), found.rms, found.p99, found.inside)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One run of the method: by a limit, or at a fixed interval."""

    dense_h: float
    limit: float | None = None
    interval_min: float | None = None

    def points(self, method: Deciding, series: Series, seed: int, measure_first: bool) -> list[Point]:
        """One result for the errors in µm, and one for those in µm/m, if any."""
        what = f"{self.limit} µm"
        used: BoolArray = np.asarray(np.isfinite(series.truth).any(axis=1))
        course: MethodCourse | None
        if self.interval_min is not None:
            what = f"{self.interval_min:g} min"
            used = rows_to_measure(series, self.dense_h, self.interval_min, measure_first)
            course = apply_method(method, series, used, seed, self.dense_h, self.interval_min)
        elif self.limit is not None:
            dense_steps = round(self.dense_h * 3600.0 / series.step_s)
            given = given_of(series, used, seed, dense_steps, 1, measure_first)
            course, used = method.decide(given, self.limit)
        if course is None:
            return []
        units = [np.flatnonzero(there).tolist() for there in (~series.angle, series.angle) if there.any()]
        return [point_of(what, series, course, used, self.dense_h, errors) for errors in units]


def savings(policy: Sequence[Point], fixed: Sequence[Point]) -> list[Saving]:
    """Each point of the policy against the fixed intervals."""
    return [
        Saving(
            p,
            p.measurements / _needed([f.measurements for f in fixed], [f.rms for f in fixed], p.rms),
            p.measurements / _needed([f.measurements for f in fixed], [f.p99 for f in fixed], p.p99),
        )
        for p in policy
    ]


def _needed(measurements: Sequence[int], left: Sequence[float], target: float) -> float:
    """Measurements at which a fixed interval leaves `target`, between the intervals that were run; NaN beyond them.

    Where a denser interval happens to leave a larger error than a sparser one, the sparser one counts.
    """
    order = np.argsort(measurements)
    n = np.log(np.asarray(measurements, dtype=np.float64)[order])
    best: FloatArray = np.log(np.minimum.accumulate(np.asarray(left, dtype=np.float64)[order]))
    if not best[-1] <= np.log(target) <= best[0]:
        return float("nan")
    better = np.append(True, np.diff(best) < 0)
    return float(np.exp(np.interp(-np.log(target), -best[better], n[better])))
