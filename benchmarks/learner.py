"""The learner on the simulated machines: dense and sparse beginnings, the first hours, a prior, and its cost.

E_RMS is judged before each measurement, against the truth, beside measure-and-hold at the same times, or nothing.
"""

import os
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.data import machine_days
from benchmarks.rows import BenchRow
from studies import Days, held
from talc.control import Controller
from talc.frame import BoolArray, FloatArray, Frame, Measurement
from talc.indicators import TWO_SIDED_95, rms
from talc.learner import LearnerState, Prior, make_prior
from talc.settings import TalcSettings

_SETTINGS = TalcSettings(method="learner")
_HOUR, _DAY, _HOURS = 12, 288, 96
MACHINES = tuple((kind, seed) for kind in ("day", "axes") for seed in range(8))
_POSITIONS = 6
_STRETCHES = ((0, 2), (2, 6), (6, 24), (24, _HOURS))
"""Edges of the learning curve, in hours."""


@dataclass(frozen=True, slots=True)
class LearnerOutcome:
    """One machine's four days; per thermal error."""

    left: FloatArray
    """(T, 9) truth minus estimate."""
    inside: FloatArray
    """(9,) share of the unmeasured rows in which the 95 % interval held the truth, after the first day."""
    state: LearnerState | None


def learner_outcome(m: Days, used: BoolArray, prior: Prior | None = None, keep: bool = False) -> LearnerOutcome:
    """Measured in the given rows, and in no others."""
    controller = Controller(m.names, _SETTINGS, prior=prior)
    valid = np.ones(len(m.names), dtype=np.bool_)
    predicted, corrected, sigma = np.zeros((3, *m.truth.shape))
    for k, row in enumerate(m.inputs):
        measurement = Measurement(m.measured[k], m.sigma) if used[k] else None
        decision = controller.step(Frame(k, row, valid, measurement))
        predicted[k], corrected[k], sigma[k] = np.nan_to_num(decision.predicted), decision.corrected, decision.sigma
    shown = ~used
    shown[:_DAY] = False
    inside = (np.abs(m.truth - corrected) <= TWO_SIDED_95 * sigma)[shown].mean(axis=0)
    course = controller.state().course if keep else None
    return LearnerOutcome(m.truth - predicted, inside, None if course is None else course.learner)


def day_then_every(every: int, then: int, rows: int) -> BoolArray:
    """(rows,) a day with a measurement every `every` steps, and every `then` steps after it."""
    used = np.zeros(rows, dtype=np.bool_)
    used[: _DAY + 1 : every] = True
    used[_DAY::then] = True
    return used


def _over_hold(kind: str, seed: int, every: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """E_RMS over measure-and-hold and over none, and the coverage, after the first day."""
    m = machine_days(kind, seed, _HOURS)
    used = day_then_every(every, 2 * _HOUR, len(m.inputs))
    found, after = learner_outcome(m, used), slice(_DAY + 1, None)
    figures = [np.array([rms(e) for e in errors[after].T]) for errors in (found.left, m.truth - held(m, used), m.truth)]
    return figures[0] / figures[1], figures[0] / figures[2], found.inside


def _curve(kind: str, seed: int, every: int, prior: Prior | None) -> FloatArray:
    """(4, 6) E_RMS over none in each stretch, position errors."""
    m = machine_days(kind, seed, _HOURS)
    used = np.arange(len(m.inputs)) % every == 0
    left = learner_outcome(m, used, prior).left
    return np.array(
        [
            [rms(left[a * _HOUR : b * _HOUR, e]) / rms(m.truth[a * _HOUR : b * _HOUR, e]) for e in range(_POSITIONS)]
            for a, b in _STRETCHES
        ]
    )


def _learnt(seed: int) -> tuple[tuple[str, ...], LearnerState]:
    m = machine_days("day", seed, _HOURS)
    state = learner_outcome(m, np.arange(len(m.inputs)) % _HOUR == 0, keep=True).state
    if state is None:
        raise RuntimeError("the learner has no state")
    return m.names, state


def _curve_row(name: str, curves: list[FloatArray], peer: list[FloatArray] | None = None) -> BenchRow:
    def text(several: list[FloatArray]) -> str:
        return ", ".join(f"{v:.2f}" for v in np.exp(np.log(np.array(several)).mean(axis=(0, 2))))

    return BenchRow(f"E_RMS over none, {name}; 0–2, 2–6, 6–24, 24–96 h", text(curves), text(peer) if peer else "")


def _cost() -> list[BenchRow]:
    """Measured in processor time, which other programs disturb less."""
    m = machine_days("axes", 3, 340)
    times: dict[bool, list[float]] = {True: [], False: []}
    valid, used = np.ones(len(m.names), dtype=np.bool_), day_then_every(1, 24, len(m.inputs))
    controller = Controller(m.names, _SETTINGS)
    for k, row in enumerate(m.inputs):
        frame = Frame(k, row, valid, Measurement(m.measured[k], m.sigma) if used[k] else None)
        start = time.process_time()
        controller.step(frame)
        times[bool(used[k])].append(time.process_time() - start)
    tracemalloc.start()
    small = Controller(m.names, _SETTINGS)
    for k in range(30):
        small.step(Frame(k, m.inputs[k], valid, Measurement(m.measured[k], m.sigma)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    def p(values: list[float]) -> str:
        return f"{np.percentile(values, 50) * 1e3:.2f} ms, p99 {np.percentile(values, 99) * 1e3:.2f} ms"

    return [
        BenchRow("a step with a measurement, nine errors, 36 inputs", p(times[True])),
        BenchRow("a step without one", p(times[False])),
        BenchRow("replay of 340 h, learning included", f"{sum(map(sum, times.values())):.1f} s"),
        BenchRow("memory of a controller that learns", f"{peak / 1e6:.0f} MB"),
    ]


def rows() -> list[BenchRow]:
    """All rows of the table; takes a few minutes."""
    table = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for name, every in (("5 min", 1), ("60 min", _HOUR)):
            jobs = [(*m, every) for m in MACHINES]
            found = list(pool.map(_over_hold, *zip(*jobs, strict=True)))
            ratio, none, inside = (np.array([f[i] for f in found]) for i in range(3))
            table.append(
                BenchRow(
                    f"E_RMS, a day measured each {name}, then each 2 h, 16 machines",
                    f"{np.exp(np.log(ratio).mean()):.2f} of measure-and-hold, worst {ratio.max():.2f}",
                    f"worst {none.max():.2f} of none; 95 % intervals hold {inside.mean():.0%}",
                )
            )
        hourly = list(pool.map(_curve, *zip(*((*m, _HOUR, None) for m in MACHINES), strict=True)))
        table.append(_curve_row("hourly from the start, 16 machines", hourly))
        prior = make_prior(list(pool.map(_learnt, range(7))))
        mirrored = replace(prior, mean=-prior.mean)
        order = np.random.default_rng(0).permutation(len(prior.inputs))
        exchanged = replace(prior, inputs=tuple(prior.inputs[i] for i in order))
        places = [("day", 7), ("axes", 7)]

        def curves(every: int, told: Prior | None) -> list[FloatArray]:
            return list(pool.map(_curve, *zip(*((*place, every, told) for place in places), strict=True)))

        for every in (4 * _HOUR, _HOUR):
            none_told = curves(every, None)
            name = f"each {every // _HOUR} h, prior of seven machines, on the eighth (beside: without)"
            table.append(_curve_row(name, curves(every, prior), none_told))
        for name, wrong in (("mirrored", mirrored), ("with exchanged sensors", exchanged)):
            table.append(_curve_row(f"hourly, the prior {name} (beside: without)", curves(_HOUR, wrong), none_told))
    return table + _cost()
