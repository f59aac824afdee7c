"""Training as a value: a job in, the nine models out. Deterministic for the same job on the same machine."""

from collections.abc import Callable

import numpy as np

from talc.criteria import adapted_bic
from talc.disturbance import IntArray, disturbance_of
from talc.frame import BoolArray, FloatArray, TrainingJob
from talc.models import ErrorModel, ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.output_error import Design, fit
from talc.path_search import PoleProblem, evaluate, search
from talc.settings import TrainingSettings

_POLES = (0.0, 0.7, 0.88, 0.95, 0.98)
"""Time constants at 5 min: none, 14 min, 39 min, 97 min, 4 h."""
_LEAST_VALID = 0.8
"""Share of good rows below which an input is not offered."""
_LEAST_ROWS = 24
_LEAST_SPREAD = 1e-6
_LEAST_OUTPUT_SPREAD = 1e-3
_RIDGE = 1e-4
"""Relative to unit-variance columns; tames near-equal temperatures without moving a good fit."""


class Cancelled(Exception):
    """The caller's `cancelled` said so."""


def train(
    job: TrainingJob,
    *,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> ModelSet:
    """Models of the nine errors.

    Inputs with fewer than 80 % good rows, or that never changed, are not offered; missing values are the last good
    ones. Per error and for each of five poles the Group-LASSO path proposes sets of inputs, a refit without penalty
    gives the free-run residual, and single steps (an input less, more, exchanged) go on while the adapted BIC falls.
    An error with fewer than 24 measured rows gets no model.

    progress: told the share done, 0 to 1; cancelled: asked between errors. Raises Cancelled.
    """
    columns, notes = _offered(job)
    inputs = job.inputs[:, columns]
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
    scaled = (inputs - mean) / spread
    names = tuple(job.input_names[i] for i in columns)
    lags = 1 + job.settings.max_nb
    problems: dict[bytes, list[PoleProblem]] = {}
    models: list[ErrorModel | None] = []
    for e, error in enumerate(THERMAL_ERRORS):
        if cancelled is not None and cancelled():
            raise Cancelled
        rows: BoolArray = np.isfinite(job.measured[:, e])
        if rows.sum() < _LEAST_ROWS or not columns:
            models.append(None)
            notes.append(f"{error}: no model, {int(rows.sum())} measured rows and {len(columns)} usable inputs")
            continue
        key = rows.tobytes()
        if key not in problems:
            poles = [p for p in _POLES if p < job.settings.max_pole and (p == 0.0 or job.settings.max_na >= 1)]
            problems[key] = [PoleProblem(Design.make(scaled, p, lags, rows), _RIDGE) for p in poles]
        keep = None if job.static_inputs is None else job.static_inputs[e]
        fixed = None if keep is None else tuple(names.index(name) for name in keep if name in names)
        models.append(
            _model(
                error,
                job.measured[rows, e],
                problems[key],
                np.flatnonzero(rows),
                fixed,
                job,
                names,
                columns,
                mean,
                spread,
            )
        )
        if progress is not None:
            progress((e + 1) / len(THERMAL_ERRORS))
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=tuple(models), notes=tuple(notes))


def _offered(job: TrainingJob) -> tuple[list[int], list[str]]:
    columns, notes = [], []
    for i, name in enumerate(job.input_names):
        share = float(job.valid[:, i].mean())
        if share < _LEAST_VALID or not np.isfinite(job.inputs[:, i]).all():
            notes.append(f"{name}: not offered, {share:.0%} of its values are good")
        elif job.inputs[:, i].std() > _LEAST_SPREAD:
            columns.append(i)
    return columns, notes


def _model(
    error: str,
    measured: FloatArray,
    problems: list[PoleProblem],
    steps: IntArray,
    fixed: tuple[int, ...] | None,
    job: TrainingJob,
    names: tuple[str, ...],
    columns: list[int],
    mean: FloatArray,
    spread: FloatArray,
) -> ErrorModel:
    y_mean, y_std = float(measured.mean()), max(float(measured.std()), _LEAST_OUTPUT_SPREAD)
    y = (measured - y_mean) / y_std
    tolerance = _tolerance(error, job.settings)

    def criterion(residual: FloatArray, orders: int, inputs: int) -> float:
        return adapted_bic(residual * y_std, orders, inputs, tolerance, job.settings.safety)

    if fixed is None:
        most = min(job.settings.max_inputs, len(names))
        choices = [search(problem, y, most, len(names), criterion) for problem in problems]
    else:
        choices = [evaluate(problem, y, fixed, criterion) for problem in problems]
    best = min(choices, key=lambda choice: choice.criterion)
    chosen, pole = list(best.inputs), best.problem.design.pole
    found = fit(best.problem.design, best.inputs, y, _RIDGE)
    residual = np.abs(found.residual) * y_std
    rows = job.inputs[:, [columns[i] for i in chosen]]
    reach, swing = np.ptp(rows, axis=0), max(float(np.ptp(measured)), y_std)
    return ErrorModel(
        error=error,
        inputs=tuple(names[i] for i in chosen),
        a=np.array([-pole] if pole > 0.0 else []),
        b=tuple(found.b),
        intercept=found.constant * (1.0 - pole),
        u_mean=mean[chosen],
        u_std=spread[chosen],
        y_mean=y_mean,
        y_std=y_std,
        u_low=rows.min(axis=0) - reach,
        u_high=rows.max(axis=0) + reach,
        y_low=float(measured.min()) - swing,
        y_high=float(measured.max()) + swing,
        limit=float(residual.max()),
        residual_std=float(np.sqrt(np.mean(residual**2))),
        criterion=best.criterion,
        disturbance=disturbance_of(found.residual * y_std, steps),
    )


def _tolerance(error: str, settings: TrainingSettings) -> float:
    return settings.tolerance_um if ERROR_UNITS[error] == MICROMETRE else settings.tolerance_um_per_m
