"""B19's own grid: 2,191 settings on four load cases, 8,764 runs; ARX models of seven errors by three temperatures.

What the paper does not say is our choice, and named so. All settings after one calibration run together.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, get_args

import numpy as np

from simulators.cases import Letter, table_speeds
from simulators.plant import MachineDrive, Plant, load_machine, record_drive
from studies.frame import RunParameters, Study
from studies.lockstep import run_together
from studies.loop import Days, control, days, held
from studies.parameters_points import BEST
from studies.published_grid_report import report
from talc import indicators
from talc.frame import BoolArray, FloatArray, TrainingJob
from talc.models import ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.papers.training import train
from talc.settings import ControlSettings, TalcSettings, TrainingSettings

STEP_S: Final = 300.0
CYCLE_S: Final = 95.0
"""B19's probing cycle."""
CALIBRATION_H: Final = (6.5, 12.0, 16.0, 24.0, 36.0, 48.0, 60.0)
"""Measured each 5 min."""
INTERVAL_H: Final = (*(float(h) for h in range(1, 13)), 24.0)
NG_INTERVAL_MIN: Final = (5, 10, 15, 20, 25, 30)
NG_COUNT: Final = (6, 12, 18, 24)
NEVER_H: Final = 0.0
"""Stands for the paper's “Inf”: after the calibration nothing is measured, so that no no-good phase begins."""
HOURS: Final = 192.0
"""Of a load case (choice): the longest update interval. Table 2's D alone, 16 h and then each 6 h with a Pd of 96.70 %,
needs 174 h or more by eq. 7."""
UPDATE_H: Final = (*(float(h) for h in range(8, 104, 8)), HOURS)
"""Parameter update intervals of the common set; the last one is over when the load case is."""
IDLE_S: Final = 12 * 3600.0
SEVEN: Final = THERMAL_ERRORS[2:]
"""Errors of the C axis and the table (choice: the paper has seven)."""
LINEAR: Final = tuple(i for i, name in enumerate(THERMAL_ERRORS) if name in SEVEN and ERROR_UNITS[name] == MICROMETRE)
TEMPERATURES: Final = ("c_drive", "ambient_left", "space_left")
"""Three (choice which); in D the cutting fluid's instead of the working space's."""
FLUID: Final = "cutting_fluid"
TRAINING: Final = TrainingSettings(selector="tck", estimator="least_squares", max_na=1, max_nb=1, static_inputs=True)
"""Weighted least squares on all three inputs; the orders, up to 1 (choice), are those of least BIC at each update."""
COMMON: Final[tuple[float, float, int, int]] = (BEST[0], BEST[1], 10, BEST[2])
"""The paper's best common set: calibration h, then a setting."""
_SMALL = ((1.0, 5, 6), (8.0, 30, 12), (NEVER_H, 5, 6), COMMON[1:])
_DAY = round(24 * 3600 / STEP_S)

Setting = tuple[float, int, int]
"""Interval h, no-good interval min, no-good measurements."""


def settings_of(small: bool) -> list[Setting]:
    """What is varied after a calibration."""
    if small:
        return list(_SMALL)
    grid = [(interval, apart, count) for interval in INTERVAL_H for apart in NG_INTERVAL_MIN for count in NG_COUNT]
    return [*grid, (NEVER_H, NG_INTERVAL_MIN[0], NG_COUNT[0])]


def runs(seed: int, small: bool) -> list[RunParameters]:
    """One run for each load case and calibration length, and one for its update intervals; the small version has one
    length, a few settings, and two update intervals."""
    lengths, updates = (CALIBRATION_H[:1], UPDATE_H[:1]) if small else (CALIBRATION_H, UPDATE_H[:-1])
    found: list[RunParameters] = []
    for case in get_args(Letter):
        found += [{"seed": seed, "case": case, "calibration_h": h, "small": small} for h in lengths]
        found.append({"seed": seed, "case": case, "update_h": [*updates, HOURS], "small": small})
    return found


def case_days(case: Letter, seed: int) -> Days:
    """The load case: three temperatures, and seven measured errors."""
    stretch = table_speeds(case, seed, hours=HOURS, step_s=STEP_S)
    plant = Plant(load_machine(), stretch.environment, seed)
    plant.advance(IDLE_S, MachineDrive())
    plant.zero()
    whole = days(record_drive(plant, stretch.drives, STEP_S), seed)
    names = (*TEMPERATURES[:2], FLUID if case == "D" else TEMPERATURES[2])
    measured = whole.measured.copy()
    measured[:, [i for i, name in enumerate(THERMAL_ERRORS) if name not in SEVEN]] = np.nan
    columns = [whole.names.index(name) for name in names]
    return replace(whole, names=names, inputs=whole.inputs[:, columns], measured=measured)


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """`points`: figures of each setting after one calibration length; `none`, `hold` with the common set's
    measurements, and `exact`: the common set, if probing had no noise. Or `updates`: of the common set with each update
    interval, with its RMSE day by day."""
    here = case_days(parameters["case"], parameters["seed"])
    if "update_h" in parameters:
        return {"updates": [_updated(here, hours) for hours in parameters["update_h"]]}
    length = float(parameters["calibration_h"])
    wanted = settings_of(parameters["small"])
    found = _together(here, here.measured, length, wanted)
    points = [
        {"interval_h": interval, "ng_interval_min": apart, "ng_count": count, **figures}
        for (interval, apart, count), (figures, _) in zip(wanted, found, strict=True)
    ]
    if length != COMMON[0]:
        return {"points": points}
    _, used = found[wanted.index(COMMON[1:])]
    true = np.where(np.isfinite(here.measured), here.truth, np.nan)
    return {
        "points": points,
        "exact": _together(here, true, length, [COMMON[1:]])[0][0],
        "hold": figures_of(here.truth, held(here, used), used, length),
        "none": figures_of(here.truth, np.zeros_like(here.truth), used, length),
    }


def _together(
    here: Days, measured: FloatArray, length: float, wanted: list[Setting]
) -> list[tuple[dict[str, float], BoolArray]]:
    """Each setting's figures, and when it measures."""
    courses = run_together(here.inputs, measured, [_control(length, *setting) for setting in wanted], TRAINING.max_pole)
    found = []
    for estimate, used, updates in zip(courses.estimate, courses.used, courses.updates.tolist(), strict=True):
        whole = np.full_like(here.truth, np.nan)
        whole[:, courses.errors] = estimate
        found.append((figures_of(here.truth, whole, used, length) | {"updates": updates}, used))
    return found


def _updated(here: Days, update_h: float) -> dict[str, Any]:
    chosen = replace(_control(*COMMON), update_interval_steps=None if update_h == HOURS else _steps(update_h))

    def learn(job: TrainingJob) -> ModelSet:
        return train(replace(job, static_inputs=(here.names,) * len(THERMAL_ERRORS)))

    course = control(here, TalcSettings(method="models", control=chosen, training=TRAINING), learn)
    begin = _steps(COMMON[0]) + 1
    left = (here.truth - course.estimate)[begin:, LINEAR]
    by_day = [left[k : k + _DAY] for k in range(0, len(left) - _DAY // 2, _DAY)]
    return {
        "update_h": update_h,
        **figures_of(here.truth, course.estimate, course.used, COMMON[0]),
        "updates": len(course.updates) - 1,
        "daily": [float(np.mean([indicators.rms(day[:, i]) for i in range(len(LINEAR))])) for day in by_day],
    }


def _control(calibration_h: float, interval_h: float, ng_interval_min: int, ng_count: int) -> ControlSettings:
    return ControlSettings(
        calibration_steps=_steps(calibration_h),
        measurement_interval_steps=_steps(interval_h) if interval_h != NEVER_H else _steps(HOURS),
        no_good_measurements=ng_count,
        no_good_interval_steps=round(ng_interval_min * 60 / STEP_S),
        acl="fixed",
    )


def figures_of(truth: FloatArray, estimate: FloatArray, used: BoolArray, calibration_h: float) -> dict[str, float]:
    """Means over the linear errors of SMAPE and PV, %, RMSE and P99, µm, after the calibration (B19 eq. 1-6).

    Pd (eq. 7) is over the whole series, including the calibration. `P99 together` is of the linear errors' mean
    magnitude. NaN: an error never had a model.
    """
    after = slice(_steps(calibration_h) + 1, None)
    pairs = [(truth[after, e], estimate[after, e]) for e in LINEAR]
    return {
        "SMAPE": float(np.mean([indicators.smape(t, p) for t, p in pairs])),
        "RMSE": float(np.mean([indicators.rms(t - p) for t, p in pairs])),
        "PV": float(np.mean([indicators.pv(t, p) for t, p in pairs])),
        "P99": float(np.mean([indicators.p99(t - p) for t, p in pairs])),
        "P99 together": indicators.p99(np.abs([t - p for t, p in pairs]).mean(axis=0)),
        "Pd": indicators.productivity(int(used.sum()), CYCLE_S, len(used) * STEP_S),
        "measurements": int(used.sum()),
    }


def _steps(hours: float) -> int:
    return round(hours * 3600 / STEP_S)


STUDY = Study(
    "published-grid",
    "B19's own 2,191 settings on its four load cases",
    runs,
    run,
    report,
    learns=lambda _: False,
)
