"""Routes from one error's rows to one model's parameters: by output error (default), or by ARX as in the papers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from talc.frame import BoolArray, FloatArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.papers import pso, tck
from talc.papers.arx import Regression, followed, guarded_fit, least_squares_fit, refine, simulate
from talc.papers.criteria import bic
from talc.papers.output_error import Design, fit
from talc.papers.search import BLOCKS, RIDGE, Candidates
from talc.papers.window import Coefficients, Structure, Window
from talc.settings import TrainingSettings

_FIRST_ITERATIONS = 10
"""Settings of the swarm that finds a first model."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One model in scaled units, and its residual."""

    inputs: tuple[int, ...]
    """Positions among the offered inputs."""
    parameters: Coefficients
    residual: FloatArray
    """Residual of the free run, over the measured rows that it reaches."""
    unseen: FloatArray
    """The same on rows that the fit has not seen, the last ones; otherwise like `residual`."""
    criterion: float
    leverage: FloatArray
    """See talc.models."""
    leverage_limit: float
    resets_history: bool


class Shared:
    """The common part of errors that were measured at the same steps: the regressions of every choice of poles.

    Parameters
    ----------
    scaled: (T, inputs) z-scores of all offered inputs
    rows: (T,) which steps were measured
    outputs: by error, (T,) in scaled units, NaN where not measured
    pole_sets: to choose from
    lags: coefficients per input at the largest order
    """

    def __init__(
        self,
        scaled: FloatArray,
        rows: BoolArray,
        outputs: Mapping[str, FloatArray],
        pole_sets: Sequence[tuple[float, ...]],
        lags: int,
    ) -> None:
        self.scaled, self.rows, self.lags = scaled, rows, lags
        self.column = {error: column for column, error in enumerate(outputs)}
        self.outputs = np.column_stack([y[rows] for y in outputs.values()])
        make = partial(Design.make, scaled, lags=lags, rows=rows)
        self.candidates = Candidates(pole_sets, make, self.outputs, scaled.shape[1])


def by_search(shared: Shared, error: str, fixed: tuple[int, ...] | None, settings: TrainingSettings) -> Fitted:
    """An output-error model (talc.papers.search). fixed: positions of inputs to keep."""
    column = shared.column[error]
    most = min(settings.max_inputs, shared.scaled.shape[1])
    best = shared.candidates.choose(column, most, fixed, settings.judged_by)
    inputs = tuple(s for s, count in enumerate(best.coefficients) if count)
    design = Design.make(shared.scaled[:, inputs], best.poles, shared.lags, shared.rows)
    counts = tuple(best.coefficients[s] for s in inputs)
    fitted = fit(design, counts, shared.outputs[:, column], RIDGE, BLOCKS)
    denominator = np.atleast_1d(np.poly(best.poles))
    return Fitted(
        inputs=inputs,
        parameters=Coefficients(denominator[1:], fitted.b, fitted.constant * float(denominator.sum())),
        residual=fitted.residual,
        unseen=fitted.unseen,
        criterion=best.criterion,
        leverage=fitted.leverage,
        leverage_limit=fitted.leverage_limit,
        resets_history=False,
    )


def by_arx(
    window: Window,
    fixed: tuple[int, ...] | None,
    error: str,
    settings: TrainingSettings,
    sensors: Callable[[], tck.Ensemble],
) -> Fitted:
    """An ARX model as in the papers; a measurement replaces its past outputs.

    ValueError: too few rows, or an unstable model; RuntimeError: no guarded fit.
    """
    seed = settings.seed * len(THERMAL_ERRORS) + THERMAL_ERRORS.index(error)
    swarm = partial(
        pso.select_by_swarm,
        seed=seed,
        criterion=settings.criterion,
        tolerance=settings.tolerance_um if ERROR_UNITS[error] == MICROMETRE else settings.tolerance_um_per_m,
        safety=settings.safety,
        most=settings.max_inputs,
    )
    window = _with_past(window, settings, swarm, fixed)
    regression = Regression(window, settings.max_na, settings.max_nb)
    criterion = np.nan
    if settings.selector == "tck" and fixed is None:
        structure = tck.select_by_clusters(regression, sensors(), most=settings.max_inputs)
    elif fixed is not None and (settings.selector == "tck" or not fixed):
        structure = _orders(regression, fixed)
    elif fixed is not None:
        kept = replace(window, u=window.u[:, fixed])
        chosen = swarm(Regression(kept, settings.max_na, settings.max_nb))
        # An input that the penalty leaves out stays, with its present value only.
        orders = dict(zip(chosen.structure.inputs, chosen.structure.nb, strict=True))
        structure = Structure(chosen.structure.na, fixed, tuple(orders.get(i, 0) for i in range(len(fixed))))
        criterion = chosen.criterion
    else:
        chosen = swarm(regression)
        structure, criterion = chosen.structure, chosen.criterion
    free = settings.estimator == "least_squares"
    parameters = least_squares_fit(regression, structure).parameters if free else guarded_fit(regression, structure)
    if settings.estimator == "refined":
        parameters = refine(window, structure, parameters, max_pole=settings.max_pole)
    largest = max(np.abs(np.roots(np.concatenate([[1.0], parameters.a]))), default=0.0)
    if largest >= settings.max_pole:
        raise ValueError(f"a pole of magnitude {largest:.4f}, expected less than {settings.max_pole}")
    left = window.y - simulate(window, structure, parameters)
    residual = left[np.isfinite(left)]
    leverage, limit = _leverage(window, structure, parameters)
    return Fitted(
        inputs=structure.inputs,
        parameters=parameters,
        residual=residual,
        unseen=residual,
        criterion=float(criterion) if np.isfinite(criterion) else float(np.mean(residual**2)),
        leverage=leverage,
        leverage_limit=limit,
        resets_history=True,
    )


def _leverage(window: Window, structure: Structure, parameters: Coefficients) -> tuple[FloatArray, float]:
    """(p, p) inverse of X'X / T of the inputs as the free run filters them, over all rows, and the largest leverage.

    It tells inputs that training has not seen, wherever outputs were measured. Before the record they stood still.
    """
    from scipy.signal import lfilter

    lags = [(s, j) for s, nb in zip(structure.inputs, structure.nb, strict=True) for j in range(nb + 1)]
    if not lags:
        return np.zeros((0, 0)), 0.0
    before = max(structure.nb)
    u = np.vstack([np.repeat(window.u[:1], before, axis=0), window.u])
    x = np.column_stack([u[before - j : len(u) - j, s] for s, j in lags])
    a = np.concatenate([[1.0], parameters.a])
    still = x[0] / a.sum()
    x = lfilter([1.0], a, x - x[0], axis=0) + still
    scale = np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-12)
    own = x / scale
    inverse = np.linalg.pinv(own.T @ own / len(own) + RIDGE * np.eye(len(lags)), hermitian=True)
    reach = float(np.einsum("ij,jk,ik->i", own, inverse, own).max())
    return np.asarray(inverse / np.outer(scale, scale), dtype=np.float64), reach


def _with_past(
    window: Window, settings: TrainingSettings, swarm: Callable[..., pso.Chosen], fixed: tuple[int, ...] | None
) -> Window:
    """The rows with unmeasured outputs as a first model estimates them, so that every measured row counts.

    Z22 eq. 2 and 5: an unmeasured past output is the model's own prediction; the weights stand on the measured rows.
    Estimates that were made at the time, if there are any, are taken; otherwise a first model's, on the rows whose
    earlier outputs were measured: a short swarm's, or of the inputs that are kept. Where every second step is measured,
    as in B19's no-good phase, those rows are the calibration's alone, and days later such a model is far off.
    """
    if np.isfinite(window.past[np.isnan(window.y)]).any():
        return window
    regression = Regression(window, settings.max_na, settings.max_nb)
    reach = max(settings.max_na, settings.max_nb)
    if len(regression.y) == np.isfinite(window.y[reach:]).sum():
        return window
    structure = _orders(regression, fixed) if fixed else swarm(regression, iterations=_FIRST_ITERATIONS).structure
    parameters = least_squares_fit(regression, structure).parameters
    if np.any(np.abs(np.roots(np.concatenate([[1.0], parameters.a]))) >= settings.max_pole):
        return window
    return replace(window, past=followed(window, structure, parameters))


def _orders(regression: Regression, inputs: tuple[int, ...]) -> Structure:
    """The orders of least BIC for inputs that are kept (Z22: static inputs)."""

    def cost(structure: Structure) -> float:
        residual = least_squares_fit(regression, structure).residual
        return bic(residual, 1 + structure.na + sum(nb + 1 for nb in structure.nb))

    offered = [
        Structure(na, inputs, (nb,) * len(inputs))
        for na in range(regression.na + 1)
        for nb in range(regression.nb + 1 if inputs else 1)
    ]
    return min(offered, key=cost)
