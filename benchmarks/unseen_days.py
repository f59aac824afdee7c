"""Methods on unseen days: the whole control loop over 16 simulated machines, compared with measure-and-hold.

A first day, then three days with a measurement every two hours (and those that a model update requests), on eight
machines (benchmarks.data.varied) under a shop's day and under random loads of single axes. Measure-and-hold corrects
by the last measured error, measured at the same times. Errors are judged before each measurement, against the truth.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from benchmarks.data import machine_days
from benchmarks.rows import BenchRow
from studies import control, held
from talc.frame import BoolArray, FloatArray
from talc.indicators import TWO_SIDED_95, peak_to_peak, rms
from talc.settings import ControlSettings, TalcSettings, TrainingSettings

_DAY, HOURS = 288, 96
_INTERVAL = 24
"""Steps: 2 h."""
KINDS: tuple[str, ...] = ("day", "axes")
SEEDS: Sequence[int] = range(8)
REPEATS = 4


@dataclass(frozen=True, slots=True)
class UnseenOutcome:
    """One machine's four days; per thermal error."""

    rms: FloatArray
    hold: FloatArray
    inside: FloatArray
    """Share of the truth inside the 95 % interval."""
    swing: FloatArray
    """E_PV, µm and µm/m."""
    measurements: int
    """After the first day."""
    updates: int


@dataclass(frozen=True, slots=True)
class Way:
    """One method."""

    name: str
    training: TrainingSettings = field(default_factory=TrainingSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    learner_each: int | None = None
    """The learner, measured at this interval, in steps, on the first day and then every 2 h; None: the models."""

    def measured(self, rows: int) -> BoolArray | None:
        """(rows,) when the learner is measured; None: when the models request it."""
        if self.learner_each is None:
            return None
        used = np.zeros(rows, dtype=np.bool_)
        used[: _DAY + 1 : self.learner_each] = True
        used[_DAY::_INTERVAL] = True
        return used

    @property
    def settings(self) -> TalcSettings:
        if self.learner_each is not None:
            return TalcSettings(method="learner")
        return TalcSettings(method="models", control=self.control, training=self.training)


WAYS = (
    Way("the learner, first day measured each 5 min", learner_each=1),
    Way("the learner, first day measured each hour", learner_each=12),
    Way("`search`, judged on unseen rows"),
    Way("`search`, judged on the fit's rows", TrainingSettings(judged_by="seen")),
    Way("`search`, limits from training (Z22)", control=ControlSettings(acl="training")),
    Way(
        "`pso`, ARX to order 5, least squares",
        TrainingSettings(selector="pso", max_na=5, max_nb=5, estimator="least_squares"),
    ),
    Way("`pso`, refined free run, orders up to 1", TrainingSettings(selector="pso", max_nb=1, estimator="refined")),
    Way("`search`, policy `uncertainty`", control=ControlSettings(policy="uncertainty")),
    Way("`search`, policy `novelty`", control=ControlSettings(policy="novelty")),
    Way("`search`, fixed 4 h", control=ControlSettings(measurement_interval_steps=48)),
    Way("`search`, calibration measured each 30 min", control=ControlSettings(calibration_interval_steps=6)),
    Way("`search`, orders up to 1", TrainingSettings(max_nb=1)),
)


def unseen_outcome(way: Way, kind: str, seed: int, noise_seed: int | None = None) -> UnseenOutcome:
    """One machine through calibration and three days."""
    m = machine_days(kind, seed, HOURS, noise_seed=noise_seed)
    course = control(m, way.settings, measured=way.measured(len(m.truth)))
    after = slice(_DAY + 1, None)
    left, hold = m.truth - course.estimate, m.truth - held(m, course.used)
    sigma = np.where(course.used[:, None], np.nan, course.sigma)
    inside = np.array(
        [
            np.mean(np.abs(e[known]) <= TWO_SIDED_95 * s[known])
            for e, s in zip(left[after].T, sigma[after].T, strict=True)
            if (known := np.isfinite(s)).any()
        ]
    )
    return UnseenOutcome(
        np.array([rms(e) for e in left[after].T]),
        np.array([rms(e) for e in hold[after].T]),
        inside,
        np.array([peak_to_peak(e) for e in left[after].T]),
        int(course.used[_DAY:].sum()),
        sum(row > _DAY for row, _ in course.updates),
    )


def _line(way: Way, outcomes: list[UnseenOutcome], default: list[UnseenOutcome]) -> BenchRow:
    """default: of the first way; its measurement times are the common yardstick for all ways."""
    ratio = np.array([o.rms / o.hold for o in outcomes])
    common = np.array([o.rms / d.hold for o, d in zip(outcomes, default, strict=True)])
    inside = np.concatenate([o.inside for o in outcomes])
    return BenchRow(
        f"E_RMS of {way.name}, geometric mean of {ratio.size} series",
        f"{np.exp(np.log(ratio).mean()):.2f} of measure-and-hold, worst {ratio.max():.2f}, "
        f"{np.mean(ratio > 0.6):.0%} above 0.6",
        f"{np.exp(np.log(common).mean()):.2f} of the first way's; "
        f"{np.mean([o.measurements for o in outcomes]):.0f} measurements, "
        f"{np.mean([o.updates for o in outcomes]):.1f} updates; 95 % intervals hold {inside.mean():.0%}",
    )


def _spread(way: Way, outcomes: list[UnseenOutcome]) -> BenchRow:
    swing = np.array([o.swing for o in outcomes])
    return BenchRow(
        f"E_PV of {way.name} under {REPEATS} draws of noise",
        f"mean {swing[:, :6].mean():.1f} µm, standard deviation {swing[:, :6].std(axis=0, ddof=1).mean():.2f} µm",
        f"{np.mean([o.updates for o in outcomes]):.1f} updates",
    )


def rows() -> list[BenchRow]:
    """All ways on all machines, then the spread over fresh sensor noise on the same physics."""
    table = []
    spread_ways = (
        WAYS[0],
        WAYS[2],
        WAYS[5],
        Way("`tck`, least squares", TrainingSettings(selector="tck", max_na=1, max_nb=1, estimator="least_squares")),
    )
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        default: list[UnseenOutcome] = []
        for way in WAYS:
            jobs = [(way, kind, seed) for kind in KINDS for seed in SEEDS]
            outcomes = list(pool.map(unseen_outcome, *zip(*jobs, strict=True)))
            default = default or outcomes
            table.append(_line(way, outcomes, default))
        for way in spread_ways:
            repeats = range(100, 100 + REPEATS)
            outcomes = list(pool.map(unseen_outcome, [way] * REPEATS, ["day"] * REPEATS, [0] * REPEATS, repeats))
            table.append(_spread(way, outcomes))
    return table
