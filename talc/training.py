"""Training as a value: a job in, the nine models out. Deterministic for the same job on the same machine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from talc.criteria import adapted_bic
from talc.frame import BoolArray, FloatArray, TrainingJob
from talc.group_lasso import GroupLasso
from talc.models import ErrorModel, ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.output_error import Design, Fit, fit
from talc.settings import TrainingSettings

_POLES = (0.0, 0.7, 0.88, 0.95, 0.98)
"""Time constants at 5 min: none, 14 min, 39 min, 97 min, 4 h."""
_LEAST_VALID = 0.8
"""Share of good rows below which an input is not offered."""
_LEAST_ROWS = 24
_LEAST_SPREAD = 1e-6
_PENALTIES = np.geomspace(0.6, 2e-3, 10)
"""Points of the path, relative to the smallest penalty that leaves no input."""
_GAP = 1e-3
_ITERATIONS = 300
_RIDGE = 1e-4
"""Relative to unit-variance columns; tames near-equal temperatures without moving a good fit."""


class Cancelled(Exception):
    """The caller's `cancelled` said so."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    criterion: float
    design: Design
    inputs: tuple[int, ...]
    """Positions among the offered inputs."""
    fit: Fit


def train(
    job: TrainingJob,
    *,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> ModelSet:
    """Models of the nine errors.

    Inputs with fewer than 80 % good rows, or that never changed, are not offered; missing values are the last good
    ones. Per error the Group-LASSO path over each of five poles proposes sets of inputs, a refit without penalty gives
    the free-run residual, and the adapted BIC chooses. An error with fewer than 24 measured rows gets no model.

    progress: told the share done, 0 to 1; cancelled: asked between errors. Raises Cancelled.
    """
    columns, notes = _offered(job)
    inputs = job.inputs[:, columns]
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
    scaled = (inputs - mean) / spread
    names = tuple(job.input_names[i] for i in columns)
    lags = 1 + min(1, job.settings.max_nb)
    designs: dict[bytes, list[tuple[Design, FloatArray, FloatArray, GroupLasso]]] = {}
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
        if key not in designs:
            poles = [p for p in _POLES if p < job.settings.max_pole and (p == 0.0 or job.settings.max_na >= 1)]
            designs[key] = [_prepared(Design.make(scaled, p, lags, rows)) for p in poles]
        keep = None if job.static_inputs is None else job.static_inputs[e]
        fixed = None if keep is None else tuple(names.index(name) for name in keep if name in names)
        models.append(_model(error, job.measured[rows, e], designs[key], fixed, job, names, columns, mean, spread))
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


def _prepared(design: Design) -> tuple[Design, FloatArray, FloatArray, GroupLasso]:
    """The design with unit-variance columns, its nuisance projected out, and the solver on its Gram matrix."""
    q, _ = qr(design.nuisance, mode="economic")
    x = design.columns - q @ (q.T @ design.columns)
    x = np.asarray(x / np.maximum(np.linalg.norm(x, axis=0), 1e-12), dtype=np.float64)
    return design, np.asarray(q, dtype=np.float64), x, GroupLasso(np.asarray(x.T @ x), design.lags)


def _model(
    error: str,
    measured: FloatArray,
    designs: list[tuple[Design, FloatArray, FloatArray, GroupLasso]],
    fixed: tuple[int, ...] | None,
    job: TrainingJob,
    names: tuple[str, ...],
    columns: list[int],
    mean: FloatArray,
    spread: FloatArray,
) -> ErrorModel:
    y_mean, y_std = float(measured.mean()), max(float(measured.std()), 1e-3)
    y = (measured - y_mean) / y_std
    tolerance = _tolerance(error, job.settings)
    best: _Candidate | None = None
    for design, q, x, lasso in designs:
        for inputs in _proposals(y, q, x, lasso, job.settings.max_inputs) if fixed is None else [fixed]:
            found = fit(design, inputs, y, _RIDGE)
            orders = (design.pole > 0.0) + len(inputs) * (design.lags - 1)
            cost = adapted_bic(found.residual * y_std, orders, len(inputs), tolerance, job.settings.safety)
            if best is None or cost < best.criterion:
                best = _Candidate(cost, design, inputs, found)
    if best is None:
        raise RuntimeError("no candidate model: a path always holds the empty set")
    chosen = list(best.inputs)
    residual = np.abs(best.fit.residual) * y_std
    rows = job.inputs[:, [columns[i] for i in chosen]]
    reach, swing = np.ptp(rows, axis=0), max(float(np.ptp(measured)), y_std)
    return ErrorModel(
        error=error,
        inputs=tuple(names[i] for i in chosen),
        a=np.array([-best.design.pole] if best.design.pole > 0.0 else []),
        b=tuple(best.fit.b),
        intercept=best.fit.constant * (1.0 - best.design.pole),
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
    )


def _proposals(y: FloatArray, q: FloatArray, x: FloatArray, lasso: GroupLasso, most: int) -> list[tuple[int, ...]]:
    """Different sets of inputs along the path, the empty one first."""
    rest = y - q @ (q.T @ y)
    moment, energy = np.asarray(x.T @ rest), float(rest @ rest)
    top = lasso.largest(moment)
    found: list[tuple[int, ...]] = [()]
    start = None
    for share in _PENALTIES:
        solution = lasso.solve(moment, energy, float(share) * top, start, _GAP, _ITERATIONS)
        start = solution.coefficients
        if len(solution.active) > most:
            # The strongest ones still are a proposal; further down the path there are only more.
            strength = np.linalg.norm(solution.coefficients, axis=1)
            found.append(tuple(sorted(int(i) for i in np.argsort(-strength, kind="stable")[:most])))
            break
        found.append(solution.active)
    return list(dict.fromkeys(found))


def _tolerance(error: str, settings: TrainingSettings) -> float:
    return settings.tolerance_um if ERROR_UNITS[error] == MICROMETRE else settings.tolerance_um_per_m
