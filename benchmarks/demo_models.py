"""The demo with the papers' system of trained models beside the learner, in simulated time, on ten seeds."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from benchmarks.demo import DemoLoop, spread
from benchmarks.rows import BenchRow
from gateway.reporting.data import ReportData
from talc.indicators import rms
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.settings import TalcSettings

SEEDS = range(1, 11)
HOURS, CALIBRATION_S = 72.0, 25 * 3600.0
"""Both are judged from here on: a day of calibration, and an hour in which the first models are trained."""
METHODS: tuple[Literal["learner", "models"], ...] = ("learner", "models")
NAMES = (*THERMAL_ERRORS, "tool X", "tool Y", "tool Z")
UNITS = (*(ERROR_UNITS[name] for name in THERMAL_ERRORS), *[MICROMETRE] * 3)


@dataclass(frozen=True, slots=True)
class LaterHours:
    """One run after the calibration's time, RMS of the nine errors and of the tool's three directions."""

    without: tuple[float, ...]
    left: tuple[float, ...]
    measurements: int
    """In all, from the start."""


def run_later(seed: int, method: Literal["learner", "models"]) -> LaterHours:
    """72 h of the demo."""
    return later(DemoLoop(seed, HOURS, TalcSettings(method=method)).run(), CALIBRATION_S)


def later(data: ReportData, since_s: float) -> LaterHours:
    """Against the simulated truth of each minute; the tool where the machine does not probe."""
    truth = data.truth
    if truth is None:
        raise ValueError("only a simulation knows the truth")
    use = (truth.time_s >= since_s) & data.truth_ran
    cutting = use & ~truth.probing
    estimate = np.nan_to_num(data.corrected[data.rows_at(truth.time_s[use])])
    without = [*truth.errors[use].T, *truth.uncompensated_um[cutting].T]
    left = [*(truth.errors[use] - estimate).T, *truth.compensated_um[cutting].T]
    measured = int(np.isfinite(data.measured).any(axis=1).sum())
    return LaterHours(tuple(map(rms, without)), tuple(map(rms, left)), measured)


def rows() -> list[BenchRow]:
    """All rows of the table; takes some minutes."""
    pairs = list(product(METHODS, SEEDS))
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(run_later, [seed for _, seed in pairs], [method for method, _ in pairs]))
    return list(later_table(found[: len(SEEDS)], found[len(SEEDS) :]))


def later_table(learner: Sequence[LaterHours], models: Sequence[LaterHours]) -> Iterator[BenchRow]:
    """Medians and ranges; runs of the same seed stand at the same place."""
    for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        less = sum(m.left[i] < seed.left[i] for m, seed in zip(models, learner, strict=True))
        beside = f"{spread([r.left[i] for r in models])} models; less in {less} of {len(models)}"
        without = f"{spread([r.without[i] for r in learner])} without"
        yield BenchRow(
            f"{name}, E_RMS, {unit}", f"{spread([r.left[i] for r in learner])} learner", f"{beside}; {without}"
        )
    yield BenchRow(
        "measurements in 72 h",
        spread([float(r.measurements) for r in learner], 0),
        f"{spread([float(r.measurements) for r in models], 0)} models",
    )
