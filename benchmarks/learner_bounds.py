"""Bounds of the learner's error: what its filters would reach if the mixing were done in hindsight.

On the sixteen machines of `benchmarks.learner`, judged in the same way. Nothing that is chosen in hindsight could be
used on a machine: these are bounds for any constant weights of the same filters.
"""

import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.optimize import nnls

from benchmarks.data import machine_days
from benchmarks.learner import MACHINES, day_then_every
from benchmarks.rows import BenchRow
from studies import Days, held
from talc.frame import BoolArray, FloatArray
from talc.indicators import rms
from talc.learner.features import LagBank
from talc.learner.learner import SPAN, TIME_CONSTANTS_S
from talc.learner.mixture import Mixture

_DAY, HOURS, _STEP_S = 288, 96, 300.0
_WAYS = (
    "the learner",
    "the mixture, never taken for zero",
    "the mixture or zero, by error in hindsight",
    "one filter or zero, by error in hindsight",
    "a sum of the filters with the best constant weights, by error in hindsight",
)


def bounded_predictions(
    days: Days, used: BoolArray, *, after: bool = False
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(T, 9, E) of each filter, (T, 9) of their mixture, and (T, 9) the probability that an error is not zero; before a
    row's measurement, or after it. The first row is measured."""
    inputs = days.inputs.shape[1]
    bank = LagBank(inputs, TIME_CONSTANTS_S, _STEP_S, SPAN)
    mixture = Mixture(inputs, bank.lags, _STEP_S)
    each, together, believed = [], [], []
    for k, deviation in enumerate(days.inputs - days.inputs[0]):
        if k:
            factor = bank.widen(deviation)
            if (factor > 1.0).any():
                mixture.widen(factor)
            bank.advance(deviation)
            mixture.elapse(1)
        x = bank.features()
        learnt = used[k] and after
        if learnt:
            mixture.learn(x, days.measured[k], days.sigma, np.zeros(len(days.sigma)))
        each.append(mixture.each(x))
        together.append(mixture.predict(x)[0])
        believed.append(mixture.believed)
        if used[k] and not learnt:
            mixture.learn(x, days.measured[k], days.sigma, np.zeros(len(days.sigma)))
    return np.array(each), np.array(together), np.array(believed)


def ways(truth: FloatArray, each: FloatArray, together: FloatArray, believed: FloatArray) -> FloatArray:
    """(5, 9) E_RMS of `_WAYS`, over the rows given."""
    mixture = np.array([rms(e) for e in (truth - together).T])
    none = np.array([rms(e) for e in truth.T])
    learner = np.where(believed > 0.5, believed * together, 0.0)
    single = np.sqrt(np.mean((truth[:, :, None] - each) ** 2, axis=0)).min(axis=1)
    summed = [nnls(each[:, j], truth[:, j])[1] / np.sqrt(len(truth)) for j in range(truth.shape[1])]
    return np.array(
        [
            [rms(e) for e in (truth - learner).T],
            mixture,
            np.minimum(mixture, none),
            np.minimum(single, none),
            summed,
        ]
    )


def _figures(kind: str, seed: int, every: int) -> FloatArray:
    """(5, 9) over measure-and-hold, after the first day."""
    days = machine_days(kind, seed, HOURS)
    used, after = day_then_every(every, 24, len(days.truth)), slice(_DAY + 1, None)
    found = ways(days.truth[after], *(part[after] for part in bounded_predictions(days, used)))
    hold = np.array([rms(e) for e in (days.truth - held(days, used))[after].T])
    return np.asarray(found / hold, dtype=np.float64)


def rows() -> list[BenchRow]:
    """All rows of the table; takes a minute or two."""
    table = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for name, every in (("5 min", 1), ("60 min", 12)):
            found = np.array(list(pool.map(_figures, *zip(*((*m, every) for m in MACHINES), strict=True))))
            for way, ratio in zip(_WAYS, found.transpose(1, 0, 2), strict=True):
                table.append(
                    BenchRow(
                        f"E_RMS, a day measured each {name}, then each 2 h, 16 machines: {way}",
                        f"{np.exp(np.log(ratio).mean()):.3f} of measure-and-hold, worst {ratio.max():.2f}",
                    )
                )
    return table
