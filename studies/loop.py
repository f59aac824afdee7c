"""A machine's days as the controller sees them, the controller run over them, and simple methods for comparison."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.plant import PlantRecording
from talc.control import Controller
from talc.frame import BoolArray, FloatArray, Frame, Measurement, Phase, TrainingJob
from talc.models import ModelSet
from talc.papers.training import train
from talc.probing import design_matrix
from talc.settings import TalcSettings

POSES = np.deg2rad(np.array([[0.0, 0.0], [0.0, 90.0], [0.0, 180.0], [0.0, 270.0], [90.0, 0.0], [-90.0, 0.0]]))
RADIUS_M, HEIGHT_M, TOUCH_UM = 0.2, 0.08, 1.0
STEP_S = 300.0
TEMPERATURES = 29
PAUSE = 288
"""Steps between two stretches: a day. After more than a week the record would start again."""
_RIDGE = 1e-3
"""Ridge of the static regression, relative to the number of rows: 36 nearly collinear inputs need one."""
_LEAST_ROWS = 24


@dataclass(frozen=True, slots=True)
class Days:
    """T grid steps; row k is the end of step k."""

    names: tuple[str, ...]
    inputs: FloatArray
    """(T, n) as read: temperatures in steps of 0.1 K."""
    truth: FloatArray
    """(T, 9)"""
    measured: FloatArray
    """(T, 9) the result of a six-pose probing cycle in that row."""
    sigma: FloatArray
    """(9,) standard uncertainty of a measurement."""
    begins: tuple[int, ...] = (0,)
    """Rows at which a stretch starts: `PAUSE` steps after the row before, and with a measurement."""


@dataclass(frozen=True, slots=True)
class Course:
    """The controller's course over the days."""

    estimate: FloatArray
    """(T, 9) in force when a row's measurement is made, or would be; NaN before the first models."""
    sigma: FloatArray
    """(T, 9) the standard deviation that the controller states, after a row's measurement; NaN without a model."""
    limits: FloatArray
    """(T, 9) action control limits."""
    used: BoolArray
    """(T,) a measurement was made."""
    phases: tuple[Phase, ...]
    updates: tuple[tuple[int, ModelSet], ...]
    """Row after which models were adopted, and the training's result; the first adoption ends the calibration."""


def days(recording: PlantRecording, seed: int) -> Days:
    """The recording with probing noise (1 µm a touch), in the steps of the temperature modules."""
    design = design_matrix(POSES, RADIUS_M, HEIGHT_M)
    covariance = np.linalg.inv(design.T @ design) * TOUCH_UM**2
    noise = np.random.default_rng([seed, 11]).multivariate_normal(np.zeros(9), covariance, len(recording.errors))
    raw = recording.inputs
    inputs = np.column_stack([np.round(raw[:, :TEMPERATURES], 1), np.round(raw[:, TEMPERATURES:], 2)])
    sigma = np.sqrt(np.diag(covariance))
    return Days(recording.input_names, inputs, recording.errors, recording.errors + noise, sigma)


def control(
    series: Days,
    settings: TalcSettings,
    learn: Callable[[TrainingJob], ModelSet] = train,
    *,
    measured: BoolArray | None = None,
    step_s: float = STEP_S,
) -> Course:
    """Run the controller over the days; a training (`learn`) ends within its step.

    measured: (t,) whether the first t rows have a measurement; in later rows the controller requests it. None: it
    requests all.
    """
    controller = Controller(series.names, settings, step_s)
    given = np.zeros(0, dtype=np.bool_) if measured is None else measured
    rows, errors = series.truth.shape
    estimate, sigma, limits = (np.full((rows, errors), np.nan) for _ in range(3))
    used, in_force = np.zeros(rows, dtype=np.bool_), np.full(errors, np.nan)
    valid = np.isfinite(series.inputs)
    phases, updates, asked = [], [], True
    pauses = 0
    for k in range(rows):
        if k in series.begins[1:]:
            pauses, asked = pauses + PAUSE, True
        if k < len(given):
            asked = bool(given[k])
        measurement = Measurement(series.measured[k], series.sigma) if asked else None
        decision = controller.step(Frame(k + pauses, series.inputs[k], valid[k], measurement))
        # An error without a model is corrected by its last measurement.
        estimate[k] = np.where(np.isfinite(decision.predicted), decision.predicted, in_force)
        sigma[k], limits[k], used[k], in_force = decision.sigma, decision.limits, asked, decision.corrected
        phases.append(decision.phase)
        asked = decision.measure is not None
        if decision.training is not None:
            models = learn(decision.training)
            controller.adopt(models)
            updates.append((k, models))
    return Course(estimate, sigma, limits, used, tuple(phases), tuple(updates))


def held(series: Days, used: BoolArray) -> FloatArray:
    """(T, 9) the last measurement before each row; NaN before the first one."""
    last = np.maximum.accumulate(np.where(used, np.arange(len(used)), -1))
    before = np.concatenate([[-1], last[:-1]])
    return np.where(before[:, None] >= 0, series.measured[before], np.nan)


def regressed(series: Days, used: BoolArray, renewed: BoolArray | None = None) -> FloatArray:
    """(T, 9) by a linear regression on all inputs, from all measurements so far; NaN before 24.

    renewed: (T,) measurements at which its gains are computed; None: at each. In between, only its level is set, by the
    last measurement."""
    estimate = np.full(series.truth.shape, np.nan)
    inputs = filled(series.inputs)
    rows = np.flatnonzero(used)
    since, until = rows + 1, np.append(rows[1:] + 1, len(used))
    fitted: FloatArray | None = None
    for count, (a, b) in enumerate(zip(since, until, strict=True), start=1):
        if count < _LEAST_ROWS:
            continue
        known = rows[:count]
        if fitted is None or renewed is None or renewed[known[-1]]:
            fitted = _fitted(inputs, known, series.measured[known])
        offset = 0.0 if renewed is None else series.measured[known[-1]] - fitted[known[-1]]
        estimate[a:b] = fitted[a:b] + offset
    return estimate


def fitted_in_hindsight(series: Days, rows: BoolArray) -> FloatArray:
    """(T, 9) by the same regression on the true errors of all these rows; shows how linear they are in the inputs."""
    known = np.flatnonzero(rows)
    return _fitted(filled(series.inputs), known, series.truth[known])


def _fitted(inputs: FloatArray, known: NDArray[np.intp], errors: FloatArray) -> FloatArray:
    """(T, 9) errors of all rows, with gains from the known rows."""
    mean, std = inputs[known].mean(axis=0), inputs[known].std(axis=0)
    varied = std > 1e-9
    x = (inputs[:, varied] - mean[varied]) / std[varied]
    level = errors.mean(axis=0)
    gram = x[known].T @ x[known] + _RIDGE * len(known) * np.eye(x.shape[1])
    return np.asarray(level + x @ np.linalg.solve(gram, x[known].T @ (errors - level)), dtype=np.float64)


def filled(inputs: FloatArray) -> FloatArray:
    """(T, n) An input without a reading keeps its last value, or that of the first row with one; 0 without any."""
    good = np.isfinite(inputs)
    rows = np.arange(len(inputs))[:, None]
    last = np.maximum.accumulate(np.where(good, rows, -1), axis=0)
    source = np.where(last >= 0, last, good.argmax(axis=0))
    return np.nan_to_num(np.take_along_axis(inputs, source, axis=0), nan=0.0)
