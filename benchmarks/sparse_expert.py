"""The papers' sparse models as one more expert of the learner: an experiment, not part of talc.

On the sixteen machines of `benchmarks.learner`, the models that `search` chooses run through the controller with the
same measurements, their disturbance and their sigma. Their estimate is mixed with the learner's by the learner's own
rule (talc.learner.mixture): tempered and discounted likelihoods of the measurements, and a share that is spread again.
"""

import os
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.data import machine_days
from benchmarks.learner import MACHINES, day_then_every
from benchmarks.rows import BenchRow
from studies import Days, control, held
from talc.frame import BoolArray, FloatArray
from talc.indicators import rms
from talc.settings import ControlSettings, TalcSettings

_DAY, HOURS, _INTERVAL = 288, 96, 24
_TEMPER, _KEPT, _SHARED, _LEAST_NOISE = 0.3, 0.97, 0.01, 0.25
"""As in talc.learner.mixture."""
_SHARES = {"an eighteenth of the weight": 1.0 / 18.0, "half of the weight": 0.5}
"""First weight of the models, and their part of the weight that is spread."""


def mixed(days: Days, used: BoolArray, ways: list[tuple[FloatArray, FloatArray]], share: float) -> FloatArray:
    """(T, 9) estimates of the learner and the models together; each way: (T, 9) estimates before a row's measurement,
    and the standard deviations stated after it."""
    first = np.array([1.0 - share, share])
    (ours, _), (theirs, _) = ways
    log_weight = np.tile(np.log(first), (ours.shape[1], 1))
    found = ours.copy()
    for k in range(1, len(ours)):
        known = np.isfinite(theirs[k]) & np.isfinite(ways[1][1][k - 1]) & (ours[k] != 0.0)
        weight = np.exp(log_weight[:, 1])
        found[k] = np.where(known, ours[k] + weight * (theirs[k] - ours[k]), ours[k])
        if not used[k]:
            continue
        noise = np.maximum(days.sigma, _LEAST_NOISE) ** 2
        variance = np.stack([sigma[k - 1] ** 2 + noise for _, sigma in ways], axis=1)
        square = np.stack([(days.measured[k] - estimate[k]) ** 2 for estimate, _ in ways], axis=1)
        new = _KEPT * log_weight - _TEMPER * 0.5 * (np.log(variance) + square / variance)
        likely = np.exp(new - np.nanmax(new, axis=1, initial=-np.inf, keepdims=True))
        spread = (1.0 - _SHARED) * likely / likely.sum(axis=1, keepdims=True) + _SHARED * first
        log_weight = np.where(known[:, None], np.log(spread), log_weight)
    return found


def _figures(kind: str, seed: int, every: int) -> tuple[dict[str, FloatArray], float]:
    """(2, 9) E_RMS over measure-and-hold and over none after the first day, by way; seconds that trainings took."""
    days = machine_days(kind, seed, HOURS)
    used = day_then_every(every, _INTERVAL, len(days.truth))
    learner = control(days, TalcSettings(method="learner"), measured=used)
    begin = time.process_time()
    sparse = TalcSettings(method="models", control=ControlSettings(calibration_interval_steps=every))
    models = control(days, sparse, measured=used)
    took = time.process_time() - begin
    ours = np.nan_to_num(learner.estimate)
    ways = [(ours, learner.sigma), (models.estimate, models.sigma)]
    estimates = {"the learner": ours, "`search`": models.estimate}
    estimates |= {f"both, `search` {name}": mixed(days, used, ways, share) for name, share in _SHARES.items()}
    after = slice(_DAY + 1, None)
    hold, none = (np.array([rms(e) for e in left[after].T]) for left in (days.truth - held(days, used), days.truth))
    left = {name: np.array([rms(e) for e in (days.truth - e)[after].T]) for name, e in estimates.items()}
    return {name: np.array([e / hold, e / none]) for name, e in left.items()}, took


def rows() -> list[BenchRow]:
    """All rows of the table; takes several minutes."""
    table = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for name, every in (("5 min", 1), ("60 min", 12)):
            done = list(pool.map(_figures, *zip(*((*m, every) for m in MACHINES), strict=True)))
            for way in done[0][0]:
                ratio = np.array([found[way] for found, _ in done])
                took = f"; its trainings and steps {np.mean([t for _, t in done]):.0f} s a machine"
                table.append(
                    BenchRow(
                        f"E_RMS, a day measured each {name}, then each 2 h, 16 machines: {way}",
                        f"{np.exp(np.log(ratio[:, 0]).mean()):.3f} of measure-and-hold, worst {ratio[:, 0].max():.2f}",
                        f"worst {ratio[:, 1].max():.2f} of none" + (took if way == "`search`" else ""),
                    )
                )
    return table
