"""B19's own grid: 2,191 settings on four load cases, 8,764 runs; ARX models of seven errors by three temperatures.

What the paper does not say is our choice, and named so.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, get_args

import numpy as np

from simulators.cases import Letter, table_speeds
from simulators.plant import MachineDrive, Plant, load_machine, record_drive
from studies.frame import RunParameters, Study
from studies.loop import Course, Days, control, days, held
from studies.parameters_points import BEST
from studies.published_grid_report import report
from talc import indicators
from talc.frame import BoolArray, FloatArray, TrainingJob, Why
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
HOURS: Final = 168.0
"""Of a load case (choice)."""
IDLE_S: Final = 12 * 3600.0
SEVEN: Final = THERMAL_ERRORS[2:]
"""Errors of the C axis and the table (choice: the paper has seven)."""
LINEAR: Final = tuple(i for i, name in enumerate(THERMAL_ERRORS) if name in SEVEN and ERROR_UNITS[name] == MICROMETRE)
TEMPERATURES: Final = ("c_drive", "ambient_left", "space_left")
"""Three (choice which); in D the cutting fluid's instead of the working space's."""
FLUID: Final = "cutting_fluid"
TRAINING: Final = TrainingSettings(selector="tck", estimator="least_squares", max_na=1, max_nb=1, static_inputs=True)
"""Weighted least squares on all three inputs; the orders, up to 1 (choice), are those of least BIC at each update."""
_SMALL = ((1.0, 5, 6), (8.0, 30, 12), (NEVER_H, 5, 6), (BEST[1], 10, BEST[2]))

Setting = tuple[float, int, int]
"""Interval h, no-good interval min, no-good measurements."""


def settings_of(small: bool) -> list[Setting]:
    """What is varied after a calibration."""
    if small:
        return list(_SMALL)
    grid = [(interval, apart, count) for interval in INTERVAL_H for apart in NG_INTERVAL_MIN for count in NG_COUNT]
    return [*grid, (NEVER_H, NG_INTERVAL_MIN[0], NG_COUNT[0])]


def runs(seed: int, small: bool) -> list[RunParameters]:
    """One run for each load case and calibration length; the small version has one length and a few settings."""
    lengths = CALIBRATION_H[:1] if small else CALIBRATION_H
    return [
        {"seed": seed, "case": case, "calibration_h": h, "small": small} for case in get_args(Letter) for h in lengths
    ]


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
    """`points`: figures of each setting after one calibration length; `none`, and `hold` with the common set's
    measurements."""
    here = case_days(parameters["case"], parameters["seed"])
    length = float(parameters["calibration_h"])
    first: dict[int, ModelSet] = {}

    def learn(job: TrainingJob) -> ModelSet:
        whole = replace(job, static_inputs=(here.names,) * len(THERMAL_ERRORS))
        if job.why is not Why.CALIBRATION:
            return train(whole)
        if job.k not in first:  # the same rows in every setting
            first[job.k] = train(whole)
        return first[job.k]

    points: list[dict[str, Any]] = []
    beside: dict[str, Any] = {}
    for interval, apart, count in settings_of(parameters["small"]):
        course = control(here, _talc(length, interval, apart, count), learn)
        at = {"interval_h": interval, "ng_interval_min": apart, "ng_count": count}
        points.append({**at, **_figures(here, course.estimate, course, length)})
        if (length, interval, count) == BEST and apart == 10:
            beside["hold"] = _figures(here, held(here, course.used), course, length)
            beside["none"] = _figures(here, np.zeros_like(here.truth), course, length)
    return {"points": points, **beside}


def _talc(calibration_h: float, interval_h: float, ng_interval_min: int, ng_count: int) -> TalcSettings:
    rows = _steps(HOURS)
    chosen = ControlSettings(
        calibration_steps=_steps(calibration_h),
        measurement_interval_steps=_steps(interval_h) if interval_h != NEVER_H else rows,
        no_good_measurements=ng_count,
        no_good_interval_steps=round(ng_interval_min * 60 / STEP_S),
        acl="fixed",
    )
    return TalcSettings(method="models", control=chosen, training=TRAINING)


def _figures(here: Days, estimate: FloatArray, course: Course, calibration_h: float) -> dict[str, float]:
    return figures_of(here.truth, estimate, course.used, calibration_h) | {"updates": max(len(course.updates) - 1, 0)}


def figures_of(truth: FloatArray, estimate: FloatArray, used: BoolArray, calibration_h: float) -> dict[str, float]:
    """Means over the linear errors of SMAPE and PV, %, RMSE and P99, µm, after the calibration (B19 eq. 1-6).

    Pd (eq. 7) is over the whole series, including the calibration. NaN: an error never had a model.
    """
    after = slice(_steps(calibration_h) + 1, None)
    pairs = [(truth[after, e], estimate[after, e]) for e in LINEAR]
    return {
        "SMAPE": float(np.mean([indicators.smape(t, p) for t, p in pairs])),
        "RMSE": float(np.mean([indicators.rms(t - p) for t, p in pairs])),
        "PV": float(np.mean([indicators.pv(t, p) for t, p in pairs])),
        "P99": float(np.mean([indicators.p99(t - p) for t, p in pairs])),
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
    goal_min=60.0,
    learns=lambda _: False,
)
