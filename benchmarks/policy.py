"""Policies of measuring: the learner at its own request, compared with fixed intervals, on simulated machines.

On the sixteen machines of `benchmarks.learner`, from the first hour on, and on machines of which it sees little: six
temperatures chosen at random and no machine state, on a machine that is off at night. Each limit is compared with the
fixed interval that leaves an equal 99th percentile, or an equal RMSE, of the six position errors.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np

from benchmarks.data import machine_days
from benchmarks.learner import MACHINES
from benchmarks.recordings.description import InputColumn
from benchmarks.recordings.learner import Learning
from benchmarks.recordings.policy import Point, Saving, Sweep, savings
from benchmarks.recordings.series import Series
from benchmarks.rows import BenchRow
from studies import Days
from talc.frame import BoolArray, FloatArray

_LIMITS_UM = (2.5, 3.5, 5.0, 7.0, 10.0)
FIXED_MIN = (20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 240.0, 360.0, 480.0)
HOURS, _STEP_S, _POSITIONS = 96, 300.0, 6
FEW = tuple(product(("day", "axes"), (0, 5, 6)))
"""Two kinds of load; a machine as it is and two scattered ones."""
FEW_HOURS, _TEMPERATURES, _SEEN = 12 * 24, 29, 6
_ON_H, _FREE_DAYS = 14.0, (5, 6)
"""The machine is switched on for this many hours a day, and not at all at the weekend."""


def few(kind: str, seed: int, hours: int = FEW_HOURS) -> Series:
    """A machine of which only six temperatures are seen, and which is off at night and at the weekend."""

    def off(k: int) -> bool:
        day, step = divmod(k, round(24 * 3600 / _STEP_S))
        return day % 7 in _FREE_DAYS or step * _STEP_S >= _ON_H * 3600

    days = machine_days(kind, seed, hours, off=off)
    seen = np.sort(np.random.default_rng([seed, 5]).choice(_TEMPERATURES, _SEEN, replace=False))
    on = np.array([not off(k) for k in range(len(days.inputs))])
    return series_of(days, on, seen.tolist())


def series_of(days: Days, on: BoolArray, inputs: Sequence[int]) -> Series:
    """The position errors and some inputs of simulated days, in the rows in which the machine is on."""
    k = np.flatnonzero(on)
    return Series(
        name="",
        step_s=_STEP_S,
        k=k,
        run=np.cumsum(np.diff(k, prepend=k[0]) > 1),
        input_names=tuple(days.names[i] for i in inputs),
        about=tuple(InputColumn() for _ in inputs),
        inputs=days.inputs[on][:, list(inputs)],
        error_names=tuple(f"e{e}" for e in range(_POSITIONS)),
        units=("um",) * _POSITIONS,
        angle=np.zeros(_POSITIONS, dtype=np.bool_),
        truth=days.truth[on][:, :_POSITIONS],
        noise=np.zeros(_POSITIONS),
        probing=days.sigma[:_POSITIONS],
        notes=(),
    )


def _series(kind: str, seed: int, is_few: bool) -> Series:
    if is_few:
        return few(kind, seed)
    days = machine_days(kind, seed, HOURS)
    return series_of(days, np.ones(len(days.inputs), dtype=np.bool_), range(len(days.names)))


def compared(series: Series) -> list[Saving]:
    """One for each limit."""
    sweeps = [Sweep(0.0, limit=limit) for limit in _LIMITS_UM]
    sweeps += [Sweep(0.0, interval_min=interval) for interval in FIXED_MIN]
    points: list[Point] = [sweep.points(Learning(), series, 0, True)[0] for sweep in sweeps]
    return savings(points[: len(_LIMITS_UM)], points[len(_LIMITS_UM) :])


def _of_machine(kind: str, seed: int, is_few: bool) -> list[Saving]:
    return compared(_series(kind, seed, is_few))


def rows() -> list[BenchRow]:
    """All rows of the table; takes ten minutes."""
    table = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for machines, is_few in ((MACHINES, False), (FEW, True)):
            found = list(pool.map(_of_machine, *zip(*((*m, is_few) for m in machines), strict=True)))
            name = f"{len(machines)} machines" + (", six temperatures, off at night" if is_few else "")
            for i, limit in enumerate(_LIMITS_UM):
                each = [of_machine[i] for of_machine in found]
                table.append(
                    BenchRow(
                        f"measurements over a fixed interval's at equal P99, limit {limit:g} µm, {name}",
                        _spread(np.array([s.at_equal_p99 for s in each])),
                        f"at equal RMSE {_spread(np.array([s.at_equal_rms for s in each]))}; "
                        f"{np.median([s.point.measurements for s in each]):.0f} measurements, "
                        f"P99 {np.median([s.point.p99 for s in each]):.1f} µm, "
                        f"95 % intervals hold {np.mean([s.point.inside for s in each]):.0%}",
                    )
                )
    return table


def _spread(ratios: FloatArray) -> str:
    """NaN: beyond the intervals that were run."""
    known = ratios[np.isfinite(ratios)]
    if not known.size:
        return "–"
    text = f"{np.median(known):.2f} ({known.min():.2f} to {known.max():.2f})"
    return text if known.size == ratios.size else f"{text} of {known.size} machines"
