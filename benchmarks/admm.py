"""The papers' Group-LASSO solver, ADMM after Boyd et al. (2011, §6.4): the reference to compare with.

Boyd's default stopping rule leaves a duality gap near 1 on thermal data; this one stops on the gap.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from talc.frame import FloatArray

_CHECK = 25


def admm(
    gram: FloatArray,
    moment: FloatArray,
    energy: float,
    sizes: Sequence[int],
    penalty: float,
    *,
    tolerance: float = 1e-8,
    limit: int = 200_000,
) -> tuple[FloatArray, float, int]:
    """min t'Gt - 2 m't + e + penalty sum_s sqrt(g_s) ||t_s||; see talc.papers.group_lasso for the arguments.

    Returns the coefficients (p,), the relative duality gap they reach and the number of iterations.
    """
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int)
    weight = np.sqrt(np.asarray(sizes, dtype=np.float64))
    rho = 2.0 * float(np.trace(gram)) / max(len(gram), 1)
    factor = cho_factor(2.0 * gram + rho * np.eye(len(gram)))
    z, dual = np.zeros(len(gram)), np.zeros(len(gram))
    gap, iteration = np.inf, 0
    for iteration in range(1, limit + 1):
        x = cho_solve(factor, 2.0 * moment + rho * (z - dual))
        before = z
        target = x + dual
        length = np.sqrt(np.add.reduceat(target**2, starts))
        shrink = np.maximum(0.0, 1.0 - penalty * weight / rho / np.maximum(length, 1e-300))
        z = target * np.repeat(shrink, sizes)
        dual = target - z
        if iteration % _CHECK == 0:
            gap = duality_gap(gram, moment, energy, sizes, penalty, z)
            if gap <= tolerance:
                break
            # Residual balancing (Boyd §3.4.1) with the factorisation it needs.
            primal, change = float(np.linalg.norm(x - z)), rho * float(np.linalg.norm(z - before))
            if iteration <= 40 * _CHECK and (primal > 10.0 * change or change > 10.0 * primal):
                step = 2.0 if primal > change else 0.5
                rho, dual = rho * step, dual / step
                factor = cho_factor(2.0 * gram + rho * np.eye(len(gram)))
    return z, gap, iteration


def duality_gap(
    gram: FloatArray, moment: FloatArray, energy: float, sizes: Sequence[int], penalty: float, theta: FloatArray
) -> float:
    """Primal minus dual value relative to the primal; the dual point is the residual, scaled until it is feasible."""
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int)
    weight = np.sqrt(np.asarray(sizes, dtype=np.float64))
    image = gram @ theta
    misfit = max(float(energy - 2.0 * theta @ moment + theta @ image), 0.0)
    primal = misfit + penalty * float(weight @ np.sqrt(np.add.reduceat(theta**2, starts)))
    worst = float((2.0 * np.sqrt(np.add.reduceat((moment - image) ** 2, starts)) / weight).max())
    scale = min(1.0, penalty / worst) if worst > 0.0 else 1.0
    dual = 2.0 * scale * (energy - float(theta @ moment)) - scale**2 * misfit
    return max(primal - dual, 0.0) / primal if primal > 0.0 else 0.0
