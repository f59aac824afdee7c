"""From one error's rows to one model's parameters: the default route by output error, and the papers' by ARX."""

from dataclasses import dataclass

import numpy as np

from talc import pso, tck
from talc._kernel import Progress
from talc.arx import Regression, guarded_fit, least_squares_fit, refine, simulate
from talc.criteria import bic
from talc.frame import FloatArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.output_error import fit
from talc.search import BLOCKS, RIDGE, Candidates
from talc.settings import TrainingSettings
from talc.window import Parameters, Structure, Window


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """One model in scaled units, and what it leaves."""

    inputs: tuple[int, ...]
    """Positions among the offered inputs."""
    parameters: Parameters
    residual: FloatArray
    """Of the free run, over the measured rows it reaches."""
    unseen: FloatArray
    """The same on rows that the fit had not seen, the last ones; else as `residual`."""
    criterion: float
    leverage: FloatArray
    """Empty: unknown, as for ARX models; see talc.models."""
    leverage_limit: float
    resets_history: bool


def by_search(
    candidates: Candidates,
    y: FloatArray,
    most: int,
    fixed: tuple[int, ...] | None,
    settings: TrainingSettings,
    within: Progress | None,
) -> Found:
    """An output-error model (talc.search). y: (n,) measured rows; fixed: inputs to keep; within: may end it early."""
    best = candidates.choose(y, most, fixed, within, settings.judged_by)
    fitted = fit(best.design, best.coefficients, y, RIDGE, BLOCKS)
    denominator = np.atleast_1d(np.poly(best.design.poles))
    return Found(
        inputs=tuple(s for s, count in enumerate(best.coefficients) if count),
        parameters=Parameters(denominator[1:], fitted.b, fitted.constant * float(denominator.sum())),
        residual=fitted.residual,
        unseen=fitted.unseen,
        criterion=best.criterion,
        leverage=fitted.leverage,
        leverage_limit=fitted.leverage_limit,
        resets_history=False,
    )


def by_arx(
    window: Window, fixed: tuple[int, ...] | None, error: str, settings: TrainingSettings, within: Progress | None
) -> Found:
    """An ARX model as in the papers; a measurement replaces its past outputs.

    ValueError: too few rows with measured earlier outputs, or an unstable model; RuntimeError: no guarded fit.
    """
    regression = Regression(window, settings.max_na, settings.max_nb)
    seed = settings.seed * len(THERMAL_ERRORS) + THERMAL_ERRORS.index(error)
    criterion = np.nan
    if fixed is not None:
        structure = _orders(regression, fixed)
    elif settings.selector == "tck":
        structure = tck.select(regression, seed=seed, most=settings.max_inputs)
    else:
        tolerance = settings.tolerance_um if ERROR_UNITS[error] == MICROMETRE else settings.tolerance_um_per_m
        chosen = pso.select(
            regression,
            seed=seed,
            criterion=settings.criterion,
            tolerance=tolerance,
            safety=settings.safety,
            most=settings.max_inputs,
            progress=within,
        )
        structure, criterion = chosen.structure, chosen.criterion
    free = settings.estimator == "least_squares"
    parameters = (least_squares_fit if free else guarded_fit)(regression, structure).parameters
    if settings.estimator == "refined":
        parameters = refine(window, structure, parameters, max_pole=settings.max_pole)
    largest = max(np.abs(np.roots(np.concatenate([[1.0], parameters.a]))), default=0.0)
    if largest >= settings.max_pole:
        raise ValueError(f"a pole of magnitude {largest:.4f}, expected less than {settings.max_pole}")
    left = window.y - simulate(window, structure, parameters)
    residual = left[np.isfinite(left)]
    return Found(
        inputs=structure.inputs,
        parameters=parameters,
        residual=residual,
        unseen=residual,
        criterion=float(criterion) if np.isfinite(criterion) else float(np.mean(residual**2)),
        leverage=np.zeros((0, 0)),
        leverage_limit=0.0,
        resets_history=True,
    )


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
