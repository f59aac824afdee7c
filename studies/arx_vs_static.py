"""Static, FIR and ARX models of a three-body machine, with TALC's own estimators and simple methods for comparison.

The paper's orders; one load case to learn from and another one for judging, in free run without any measurement.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from simulators.three_body import DRIFTS, SOURCES, THERMOMETERS, load_reduced
from studies.arx_vs_static_report import report
from studies.frame import RunParameters, Study
from talc import indicators
from talc.control import Controller
from talc.frame import BoolArray, FloatArray, Frame, Measurement, TrainingJob, Why
from talc.names import THERMAL_ERRORS
from talc.papers.arx import Regression, guarded_fit, least_squares_fit, refine, simulate
from talc.papers.training import train
from talc.papers.window import Coefficients, Structure, Window
from talc.settings import TalcSettings, TrainingSettings

PAIRS = 30
STEPS = 576
"""48 h at 5 min, each of the two load cases."""
REST = 12
"""Steps without load at the start of each load case, as many as the longest model looks back; they are not judged."""
HIGHEST_W = (150.0, 90.0)
HOLD_STEPS = (12, 48)
"""A load lasts 1 to 4 h."""
ORDERS = {"Y": (2, 4), "Z": (10, 10)}
"""nb of the base's and the spindle's sensor, the paper's."""
PLACES = {"near": ("base_near", "spindle_near"), "far": ("base_far", "column_far")}
TEMPERATURE_NOISE_K, TEMPERATURE_STEP_K, PROBING_NOISE_um = 0.05, 0.1, 1.0
DAY_OFF = 288
"""Steps between the two load cases, for the learner."""
MEASURE_EACH = 24
"""Steps between the measurements of measure-and-hold: 2 h."""


def runs(seed: int, small: bool) -> list[RunParameters]:
    """Two load pairs in the small version."""
    return [
        {"seed": seed, "pair": pair, "sensors": place, "noise": noise}
        for pair in range(2 if small else PAIRS)
        for place in PLACES
        for noise in (False, True)
    ]


def heat(rng: np.random.Generator) -> FloatArray:
    """(STEPS, 2) W: after the rest each source has random levels, each for a random time."""
    loads = np.zeros((STEPS, len(SOURCES)))
    for s, highest in enumerate(HIGHEST_W):
        k = REST
        while k < STEPS:
            hold = int(rng.integers(HOLD_STEPS[0], HOLD_STEPS[1] + 1))
            loads[k : k + hold, s] = rng.uniform(0.0, highest)
            k += hold
    return loads


def recordings(parameters: RunParameters) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """To learn from, and to be judged on: sensors (STEPS, 2) degC as read, true drift and measured drift (STEPS, 3) µm.

    The loads depend only on seed and pair: days with near or far, clean or noisy sensors have the same loads.
    """
    chosen = [THERMOMETERS.index(name) for name in PLACES[parameters["sensors"]]]
    rng = np.random.default_rng([parameters["seed"], parameters["pair"]])
    loads = [heat(rng), heat(rng)]
    made = []
    for load_case in loads:
        drift, sensors = load_reduced().respond(load_case)
        read, measured = sensors[:, chosen], drift
        if parameters["noise"]:
            noisy = read + rng.normal(0.0, TEMPERATURE_NOISE_K, read.shape)
            read = np.round(noisy / TEMPERATURE_STEP_K) * TEMPERATURE_STEP_K
            measured = drift + rng.normal(0.0, PROBING_NOISE_um, drift.shape)
        made.append((read, drift, measured))
    return made


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """Indicators by direction and model; None where an estimator gave no model."""
    (u, _, y), (new_u, truth, new_y) = recordings(parameters)
    result: dict[str, Any] = {}
    for direction in ORDERS:
        axis = DRIFTS.index(direction)
        predicted = model_predictions(direction, u, y[:, axis], new_u, new_y[:, axis])
        result[direction] = {
            model: None if values is None else judge_forecast(truth[REST:, axis], values[REST:])
            for model, values in predicted.items()
        }
    return result


def judge_forecast(truth: FloatArray, predicted: FloatArray) -> dict[str, float]:
    """PV, %; RMSE and P99, µm; SMAPE, %: as talc.indicators defines them."""
    left = truth - predicted
    return {
        "PV": indicators.pv(truth, predicted),
        "RMSE": indicators.rms(left),
        "P99": indicators.p99(left),
        "SMAPE": indicators.smape(truth, predicted),
    }


def model_predictions(
    direction: str, u: FloatArray, y: FloatArray, new_u: FloatArray, new_y: FloatArray
) -> dict[str, FloatArray | None]:
    """(STEPS,) µm by model. u, y: the rows to learn from, all measured; of new_y a method uses only what it may see."""
    steps = np.arange(len(new_y))
    found: dict[str, FloatArray | None] = {
        "none": np.zeros(len(new_y)),
        "hold": new_y[np.maximum(steps - 1, 0) // MEASURE_EACH * MEASURE_EACH],
    }
    u_mean, u_std, y_mean, y_std = u.mean(axis=0), u.std(axis=0), float(y.mean()), float(y.std())
    scaled = (y - y_mean) / y_std
    window = Window((u - u_mean) / u_std, scaled, scaled, y_std)
    inputs, orders = (0, 1), ORDERS[direction]
    # The rows used must not depend on the model.
    regression = Regression(window, 1, max(orders))

    def free_run(structure: Structure, coefficients: Coefficients) -> FloatArray:
        past = np.full(len(new_y), np.nan)
        past[0] = (new_y[0] - y_mean) / y_std  # one measurement of the machine at rest, nothing afterwards
        record = Window((new_u - u_mean) / u_std, np.full(len(new_y), np.nan), past, y_std)
        return np.asarray(simulate(record, structure, coefficients) * y_std + y_mean, dtype=np.float64)

    plain = {
        "static": Structure(0, inputs, (0, 0)),
        "FIR": Structure(0, inputs, orders),
        "ARX": Structure(1, inputs, orders),
    }
    for model, structure in plain.items():
        found[model] = free_run(structure, least_squares_fit(regression, structure).parameters)
    structure, settings = plain["ARX"], TrainingSettings()
    try:
        guarded = guarded_fit(regression, structure)
    except RuntimeError:
        found["ARX guarded"] = found["ARX refined"] = None
    else:
        found["ARX guarded"] = free_run(structure, guarded)
        found["ARX refined"] = free_run(structure, refine(window, structure, guarded, max_pole=settings.max_pole))
    found["output error"] = _by_training(u, y, new_u, new_y[0], settings)
    found["learner"] = _by_learner(u, y, new_u, new_y[0])
    return found


def _by_training(
    u: FloatArray, y: FloatArray, new_u: FloatArray, start: float, settings: TrainingSettings
) -> FloatArray | None:
    """The forecast of the gateway with its default settings; the drift takes the place of the first error."""
    measured = np.full((len(y), len(THERMAL_ERRORS)), np.nan)
    measured[:, 0] = y
    valid: BoolArray = np.ones(u.shape, dtype=np.bool_)
    names = ("first", "second")
    job = TrainingJob(len(y) - 1, Why.CALIBRATION, names, u, valid, measured, settings)
    model = train(job).models[0]
    if model is None:
        return None
    used = new_u[:, [names.index(name) for name in model.inputs]]
    return model.free_run(used, np.full(len(new_u), np.nan), float(start))


def _by_learner(u: FloatArray, y: FloatArray, new_u: FloatArray, start: float) -> FloatArray:
    """The learner's forecast: it learns from the same rows; then a day off, one measurement, and the free run."""
    controller = Controller(("first", "second"), TalcSettings(method="learner"))
    valid, errors = np.ones(2, dtype=np.bool_), len(THERMAL_ERRORS)
    sigma = np.full(errors, PROBING_NOISE_um)

    def one(value: float) -> Measurement:
        measured = np.full(errors, np.nan)
        measured[0] = value
        return Measurement(measured, sigma)

    for k, row in enumerate(u):
        controller.step(Frame(k, row, valid, one(float(y[k]))))
    predicted = np.empty(len(new_u))
    for k, row in enumerate(new_u):
        measurement = one(start) if k == 0 else None
        predicted[k] = controller.step(Frame(len(u) + DAY_OFF + k, row, valid, measurement)).corrected[0]
    return predicted


STUDY = Study("arx-vs-static", "Static, FIR and ARX models of a three-body machine", runs, run, report)
