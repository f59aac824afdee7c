"""Bounds of the error at the demo's tool: errors known exactly, filters weighed in hindsight, more measurements.

On the first two seeds of `benchmarks.demo`, judged in the same way. No machine can have what `KNOWN` names: these are
bounds for methods that measure when the learner does.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat

import numpy as np
from scipy.optimize import nnls

from benchmarks.demo import LEARNER, DemoLoop, spread
from benchmarks.learner_bounds import bounded_predictions
from benchmarks.rows import BenchRow
from gateway.reporting.data import ReportData
from gateway.reporting.figures import SummaryRow, summary
from studies import Days
from talc.frame import FloatArray, Frame

SEEDS, HOURS = range(1, 3), 72.0
KNOWN = (
    "the errors known exactly at each grid step",
    "known exactly at each measurement and, in hindsight, linear between two",
    "known exactly at each measurement, and held until the next",
    "the learner's filters with the best constant weights, by error in hindsight",
)
_EVERY = ((12, "hourly"), (4, "each 20 min"))
"""Steps between measurements of a learner that measures more."""
WAYS = ("the learner", *KNOWN, *(f"the learner, measuring {often}" for _, often in _EVERY))


def known(data: ReportData, frames: Sequence[Frame]) -> list[FloatArray]:
    """(T, 9) of each of `KNOWN`: what would be sent after each grid step; NaN before the first measurement."""
    if data.truth is None:
        raise ValueError("only a simulation knows the truth")
    truth = data.truth.errors[np.searchsorted(data.truth.time_s, data.time_s)]
    seen = np.flatnonzero(np.isfinite(data.measured).all(axis=1))
    rows = np.arange(len(truth))
    later = rows >= seen[0]
    between = np.column_stack([np.interp(rows, seen, each[seen]) for each in truth.T])
    last = truth[seen[np.maximum(np.searchsorted(seen, rows, side="right") - 1, 0)]]
    return [np.where(later[:, None], way, np.nan) for way in (truth, between, last, _weighed(truth, frames, seen))]


def _weighed(
    truth: FloatArray, frames: Sequence[Frame], seen: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> FloatArray:
    """(T, 9) a sum of the filters, whose weights are those of least squares over all rows."""
    measurement = frames[seen[0]].measurement
    if measurement is None:
        raise ValueError(f"row {seen[0]} was not measured")
    first, used = seen[0], np.zeros(len(truth), dtype=np.bool_)
    used[seen] = True
    measured = [np.full(9, np.nan) if f.measurement is None else f.measurement.errors for f in frames]
    days = Days((), np.array([f.inputs for f in frames]), truth, np.array(measured), measurement.sigma)
    later = replace(days, inputs=days.inputs[first:], truth=truth[first:], measured=days.measured[first:])
    each, _, _ = bounded_predictions(later, used[first:], after=True)
    found = np.zeros_like(truth)
    for j in range(truth.shape[1]):
        found[first:, j] = each[:, j] @ nnls(each[:, j], truth[first:, j])[0]
    return found


def figures(seed: int, hours: float) -> list[tuple[tuple[SummaryRow, ...], int]]:
    """The tool's three directions and the number of measurements, of each of `WAYS`."""
    loop = DemoLoop(seed, hours)
    data = loop.run()
    runs = [data, *(DemoLoop(seed, hours, sent=sent).run() for sent in known(data, loop.frames))]
    for every, _ in _EVERY:
        learner = replace(LEARNER.learner, policy="fixed", measurement_interval_steps=every)
        runs.append(DemoLoop(seed, hours, replace(LEARNER, learner=learner)).run())
    found = [summary(run) for run in runs]
    return [(each.tool, each.measurements) for each in found]


def rows() -> list[BenchRow]:
    """All rows of the table; takes some minutes."""
    with ProcessPoolExecutor() as pool:
        return list(bounds_table(list(pool.map(figures, SEEDS, repeat(HOURS)))))


def bounds_table(found: Sequence[Sequence[tuple[tuple[SummaryRow, ...], int]]]) -> Iterator[BenchRow]:
    """Medians of the runs, and their ranges in brackets."""
    for way, runs in zip(WAYS, zip(*found, strict=True), strict=True):
        left, above = [], []
        for directions in zip(*(tool for tool, _ in runs), strict=True):
            left.append(spread([100.0 * r.compensated_e_rms / r.e_rms for r in directions], 0))
            above.append(str(sum(r.compensated_e_pv > r.e_pv for r in directions)))
        many = spread([float(number) for _, number in runs], 0)
        yield BenchRow(
            f"tool, {way}: E_RMS left in X, Y, Z, %",
            "; ".join(left),
            f"E_PV above that without in {', '.join(above)} of {len(runs)} seeds; {many} measurements",
            "≤ 30; 20; 6",
        )
