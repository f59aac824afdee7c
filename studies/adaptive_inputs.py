"""Inputs chosen once or at every model update, by three selectors, over Z22's 340 h in three seasons."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from simulators.cases import long_term
from simulators.plant import MachineDrive, Plant, PlantRecording, load_machine, record_drive
from studies.adaptive_inputs_report import report
from studies.frame import RunParameters, Study
from studies.loop import TEMPERATURES, Course, Days, control, days, held, regressed
from talc import indicators
from talc.frame import BoolArray, FloatArray
from talc.names import THERMAL_ERRORS
from talc.settings import ControlSettings, TalcSettings, TrainingSettings

REPETITIONS = 25
STEP_S = 300.0
IDLE_S = 12 * 3600.0
CALIBRATION = 288
"""Steps: 24 h."""
SENSOR_NOISE_K, GROWTH_NOISE_UM = 0.05, 0.2
"""Seed of each repetition; the plant's own is the same in all."""
SHOWN_EACH = 3
"""Steps between the plotted points of a series."""
SMALL_STEPS = 456
"""The small version: 38 h of the first season."""

LEARNER = "learner"
"""Chooses no inputs: it weights all of them, again at each measurement."""
MEASURE_EACH = 24
"""Steps between the learner's measurements after the first day: 2 h, as for the others."""

SELECTORS: dict[str, tuple[TrainingSettings, ControlSettings]] = {
    "pso": (
        TrainingSettings(selector="pso", estimator="least_squares", max_na=5, max_nb=5),
        ControlSettings(acl="training"),
    ),
    "tck": (
        TrainingSettings(selector="tck", estimator="least_squares", max_na=1, max_nb=1),
        ControlSettings(acl="training"),
    ),
    "search": (TrainingSettings(), ControlSettings()),
}
"""pso: Z22's Group-LASSO and swarm with its largest orders. tck: the earlier sequential selector. search: the
default."""


def runs(seed: int, small: bool) -> list[RunParameters]:
    """The physics depend on the seed alone; a repetition draws sensor and probing noise and the selector's seed.

    The small version has each selector and the learner once with adaptive inputs, and `search` with static ones.
    """
    ways: list[RunParameters] = [
        {"seed": seed, "repetition": r, "selector": selector, "inputs": inputs, "small": small}
        for r in range(1 if small else REPETITIONS)
        for selector in SELECTORS
        for inputs in ("static", "adaptive")
        if not small or selector == "search" or inputs == "adaptive"
    ]
    ways += [
        {"seed": seed, "repetition": r, "selector": LEARNER, "inputs": "adaptive", "small": small}
        for r in range(1 if small else REPETITIONS)
    ]
    return ways


def learns(parameters: RunParameters) -> bool:
    """Whether a run is the learner's."""
    return bool(parameters["selector"] == LEARNER)


def plainly_measured(here: Days) -> BoolArray:
    """(T,) every step of the first day, then every 2 h and at the start of a stretch. The errors that are found
    add none."""
    used = np.zeros(len(here.truth), dtype=np.bool_)
    used[: CALIBRATION + 1] = True
    used[CALIBRATION::MEASURE_EACH] = True
    used[list(here.begins)] = True
    return used


def season_days(seed: int, repetition: int, small: bool) -> Days:
    """The three seasons one after the other; errors count from the start of the first."""
    parts = _seasons(seed, small)
    inputs, truth = np.concatenate([p.inputs for p in parts]), np.concatenate([p.errors for p in parts])
    draw = np.random.default_rng([seed, repetition, 12])
    size = np.zeros(inputs.shape[1])
    size[:TEMPERATURES], size[TEMPERATURES] = SENSOR_NOISE_K, GROWTH_NOISE_UM
    noisy = inputs + size * draw.normal(size=inputs.shape)
    begins = np.cumsum([0, *(len(p.inputs) for p in parts[:-1])])
    made = days(PlantRecording(parts[0].input_names, noisy, truth), 1000 * seed + repetition)
    return replace(made, begins=tuple(int(b) for b in begins))


@cache
def _seasons(seed: int, small: bool) -> tuple[PlantRecording, ...]:
    """The physics, which are the same in every repetition."""
    parts: list[PlantRecording] = []
    parameters, first = load_machine(), None
    for n, stretch in enumerate(long_term(seed, step_s=STEP_S)[: 1 if small else None]):
        plant = Plant(parameters, stretch.environment, 10 * seed + n)
        plant.advance(IDLE_S, MachineDrive())
        plant.zero(first)
        first = first or plant
        parts.append(record_drive(plant, stretch.drives[: SMALL_STEPS if small else None], STEP_S))
    return tuple(parts)


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """E_PV and E_RMS of the nine errors after calibration, updates, chosen inputs; for repetition 0 a plot's series."""
    here = season_days(parameters["seed"], parameters["repetition"], parameters["small"])
    training, settings = SELECTORS.get(parameters["selector"], SELECTORS["search"])
    kept = parameters["inputs"] == "static"
    own = replace(training, seed=parameters["repetition"], static_inputs=kept)
    if learns(parameters):
        course = control(here, TalcSettings(method="learner"), measured=plainly_measured(here))
    else:
        course = control(here, TalcSettings(method="models", control=settings, training=own))
    # At the start of a stretch the estimate is from another season; its first measurement replaces it at once.
    judged = np.arange(len(here.truth)) > CALIBRATION
    judged[list(here.begins)] = False
    result: dict[str, Any] = {
        "none": _figures(here.truth[judged]),
        "models": _figures((here.truth - course.estimate)[judged]),
        "hold": _figures((here.truth - held(here, course.used))[judged]),
        "updates": [k for k, _ in course.updates[1:]],
        "measurements": int(course.used[CALIBRATION:].sum()),
        "inputs": [
            {"after": k, **{m.error: list(m.inputs) for m in models.models if m is not None}}
            for k, models in course.updates
        ],
    }
    if parameters["selector"] == "search" and not kept:
        result["regression"] = _figures((here.truth - regressed(here, course.used))[judged])
    if parameters["repetition"] == 0:
        result["drawn"] = _drawn(here, course)
    return result


def _figures(left: FloatArray) -> dict[str, list[float]]:
    """Per error, µm and µm/m."""
    return {"E_PV": [indicators.peak_to_peak(e) for e in left.T], "E_RMS": [indicators.rms(e) for e in left.T]}


def _drawn(here: Days, course: Course) -> dict[str, Any]:
    """Truth, residual and limits, every third step, rounded for the plot; None: unknown."""
    shown = slice(None, None, SHOWN_EACH)

    def rounded(values: FloatArray) -> list[list[float | None]]:
        return [[None if np.isnan(v) else round(float(v), 2) for v in line] for line in values[shown].T]

    return {
        "errors": list(THERMAL_ERRORS),
        "step_h": SHOWN_EACH * STEP_S / 3600.0,
        "truth": rounded(here.truth),
        "left": rounded(here.truth - course.estimate),
        "limits": rounded(course.limits),
    }


STUDY = Study(
    "adaptive-inputs",
    "Inputs chosen once or at every update, three selectors, 340 h",
    runs,
    run,
    report,
    learns=learns,
)
