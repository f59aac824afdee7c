"""How long to calibrate, how often to measure, how much to relearn, as in B19: every combination on four load cases.

Then policies that decide by themselves when to measure, on the same series, against the same limits.
"""

from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

import numpy as np

from simulators.cases import table_and_fluid
from simulators.cases.table_and_fluid import Letter
from simulators.plant import MachineDrive, Plant, load, record
from simulators.studies.frame import Parameters, Study
from simulators.studies.loop import Days, control, days, held, regressed
from simulators.studies.parameters_report import report
from talc import indicators
from talc.frame import BoolArray, FloatArray, TrainingJob
from talc.models import ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from talc.training import train

STEP_S = 600.0
"""B19's no-good measurements come each 10 min."""
HOURS = 96.0
IDLE_S = 12 * 3600.0
CYCLE_S = 95.0
"""B19's probing cycle."""
CALIBRATION_H = (4.0, 5.0, 6.5, 8.0, 9.5, 11.0, 12.5, 14.0, 16.0, 18.0, 20.0, 22.0, 24.0)
INTERVAL_H = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)
NO_GOOD = tuple(range(2, 27, 2))
"""13 x 13 x 13 = 2,197 combinations; B19 has 2,191, whose list is not at hand. Its best set is among ours."""
BEST_NO_GOOD = 12
"""Of the paper's best common set: 6.5 h, then 2 h, no good 12 x 10 min."""
SHARES, SOONEST_H = (1.0, 1.5, 2.0, 3.0), 0.5
"""Of the policy `uncertainty`: share of the limit that an interval may fill; it measures at most this often."""
SHORTEST_H = (2.0, 4.0)
"""Of the policy `novelty`."""
LONGEST_H, POLICY_NO_GOOD = (8.0, 16.0), (2, 4)
SPARSE, LEAST_CALIBRATION = (2, 3, 6), 24
"""Of calibrations measured less often than each 10 min: steps between measurements; the fewest a training takes."""
SPARSE_INTERVAL_H, SPARSE_NO_GOOD = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0), (2, 4, 8, 12)
"""Fixed intervals after such a calibration: as many sets as there are policies."""
_SMALL = ("uncertainty 2, 0.5 to 16 h, 4", "each 4 h, 4")
"""What the small version has of each kind."""
TRAINING = TrainingSettings(static_inputs=True, max_nb=1)
"""Inputs are chosen in the calibration and stay, as B19's do; orders to 1 and parameters are renewed."""
POSITIONS = np.array([ERROR_UNITS[name] == MICROMETRE for name in THERMAL_ERRORS])


def runs(seed: int, small: bool) -> list[Parameters]:
    """One for each load case and calibration length; the small version has two with a few combinations."""
    cases, calibrations = (("A",), (6.5, 8.0)) if small else (get_args(Letter), CALIBRATION_H)
    return [
        {"seed": seed, "case": case, "calibration_h": length, "small": small}
        for case in cases
        for length in calibrations
    ]


def series(case: Letter, seed: int) -> Days:
    """The load case on the machine, with the noise of probing."""
    stretch = table_and_fluid(case, seed, hours=HOURS, step_s=STEP_S)
    plant = Plant(load(), stretch.environment, seed)
    plant.advance(IDLE_S, MachineDrive())
    plant.zero()
    return days(record(plant, stretch.drives, STEP_S), seed)


def run(parameters: Parameters) -> Mapping[str, Any]:
    """For one calibration length every interval and no-good length (`fixed`), every policy (`adaptive`), the same after
    calibrations measured less often (`sparse_fixed`, `sparse_adaptive`), and `none`."""
    here = series(parameters["case"], parameters["seed"])
    calibration = parameters["calibration_h"]
    first: dict[tuple[int, int], ModelSet] = {}

    def learn(job: TrainingJob) -> ModelSet:
        # The first training sees the same rows whatever comes after it.
        if job.static_inputs is not None:
            return train(job)
        seen = (job.k, int(np.isfinite(job.measured).any(axis=1).sum()))
        if seen not in first:
            first[seen] = train(job)
        return first[seen]

    def judge(settings: ControlSettings) -> tuple[dict[str, float], BoolArray]:
        course = control(here, TalcSettings(control=settings, training=TRAINING), learn)
        figures = judged(here.truth, course.estimate, course.used, calibration)
        figures["updates"] = max(len(course.updates) - 1, 0)
        hold = judged(here.truth, held(here, course.used), course.used, calibration)
        return {**figures, "hold P99": hold["P99"]}, course.used

    small = parameters["small"]
    fixed = []
    for interval in (2.0, 8.0) if small else INTERVAL_H:
        for no_good in (6, BEST_NO_GOOD) if small else NO_GOOD:
            figures, used = judge(_control(calibration, interval, no_good))
            if no_good == BEST_NO_GOOD:
                plain = judged(here.truth, regressed(here, used), used, calibration)
                figures["regression P99"] = plain["P99"]
            fixed.append({"interval_h": interval, "no_good": no_good, **figures})

    def of(kind: Callable[[float, int], list[tuple[str, ControlSettings]]], every: int) -> list[dict[str, Any]]:
        wanted = [(name, s) for name, s in kind(calibration, every) if not small or name in _SMALL]
        after = "" if every == 1 else f", calibrated each {every * STEP_S / 60:.0f} min"
        return [{"policy": name + after, **judge(settings)[0]} for name, settings in wanted]

    sparse = [n for n in SPARSE if _steps(calibration) >= LEAST_CALIBRATION * n]
    after = np.ones(len(here.truth), dtype=np.bool_)
    none = judged(here.truth, np.zeros_like(here.truth), ~after, calibration)
    return {
        "fixed": fixed,
        "adaptive": of(_policies, 1),
        "sparse_fixed": [point for every in sparse for point in of(_intervals, every)],
        "sparse_adaptive": [point for every in sparse for point in of(_policies, every)],
        "none": none,
    }


def judged(truth: FloatArray, estimate: FloatArray, used: BoolArray, calibration_h: float) -> dict[str, float]:
    """P99 and RMSE of the six position errors together, µm; mean SMAPE of the nine, %; all after the calibration.

    Pd over the whole series, calibration included: else a long calibration would cost nothing.
    """
    after = slice(_steps(calibration_h) + 1, None)
    left = (truth - estimate)[after]
    return {
        "P99": indicators.p99(left[:, POSITIONS]),
        "RMSE": indicators.rms(left[:, POSITIONS]),
        "SMAPE": float(
            np.mean([indicators.smape(t, e) for t, e in zip(truth[after].T, estimate[after].T, strict=True)])
        ),
        "Pd": indicators.productivity(int(used.sum()), CYCLE_S, len(used) * STEP_S),
        "measurements": int(used.sum()),
    }


def _steps(hours: float) -> int:
    return round(hours * 3600 / STEP_S)


def _control(calibration_h: float, interval_h: float, no_good: int, every: int = 1) -> ControlSettings:
    return ControlSettings(
        calibration_steps=_steps(calibration_h),
        calibration_interval_steps=every,
        measurement_interval_steps=_steps(interval_h),
        no_good_measurements=no_good,
        acl="fixed",
    )


def _intervals(calibration_h: float, every: int) -> list[tuple[str, ControlSettings]]:
    return [
        (f"each {interval:g} h, {no_good}", _control(calibration_h, interval, no_good, every))
        for interval in SPARSE_INTERVAL_H
        for no_good in SPARSE_NO_GOOD
    ]


def _policies(calibration_h: float, every: int) -> list[tuple[str, ControlSettings]]:
    """With names that say all that is varied: policy, share, shortest to longest interval, no-good measurements."""

    def one(policy: Literal["novelty", "uncertainty"], share: float, shortest: float) -> None:
        for longest in LONGEST_H:
            for no_good in POLICY_NO_GOOD:
                settings = ControlSettings(
                    calibration_steps=_steps(calibration_h),
                    calibration_interval_steps=every,
                    no_good_measurements=no_good,
                    acl="fixed",
                    policy=policy,
                    uncertainty_share=share,
                    shortest_interval_steps=_steps(shortest),
                    longest_interval_steps=_steps(longest),
                )
                title = f"uncertainty {share:g}" if policy == "uncertainty" else policy
                found.append((f"{title}, {shortest:g} to {longest:g} h, {no_good}", settings))

    found: list[tuple[str, ControlSettings]] = []
    for share in SHARES:
        one("uncertainty", share, SOONEST_H)
    for shortest in SHORTEST_H:
        one("novelty", 1.0, shortest)
    return found


STUDY = Study(
    "parameters", "Calibration length, measurement interval and relearning on four load cases", runs, run, report
)
