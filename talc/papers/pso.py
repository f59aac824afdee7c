"""The papers' selector: a particle swarm over the Group-LASSO's penalty and all orders (Z22 §4), in one kernel call.

Every candidate is an ARX Group-LASSO solved to a relative duality gap of 1e-8 on a sub-block of one Gram matrix; its
free run over the window is judged by a criterion. A looser solver would be exploited: the swarm finds its errors.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from talc import _kernel
from talc.frame import FloatArray
from talc.papers.arx import Regression
from talc.papers.criteria import CRITERIA, Criterion
from talc.papers.group_lasso import GroupLasso
from talc.papers.window import Structure

SWARM: Final = 40
ITERATIONS: Final = 60
_PULL: Final = 1.49
"""c1 = c2"""
_INERTIA: Final = (0.9, 0.4)
_LEAST_SHARE: Final = 1e-4
"""Smallest penalty relative to the one that leaves no input."""
_RIDGE: Final = 1e-5
"""Per row, on the Gram's diagonal: noise-free signals have a condition of 1e16."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """The result of the swarm."""

    structure: Structure
    criterion: float
    penalty: float
    gap: float
    """Relative duality gap of the best candidate."""


def select_by_swarm(
    regression: Regression,
    *,
    seed: int,
    criterion: Criterion = "adapted_bic",
    tolerance: float = 5.0,
    safety: float = 0.75,
    most: int | None = None,
    swarm: int = SWARM,
    iterations: int = ITERATIONS,
) -> Chosen:
    """Penalty, inputs and orders with the least criterion.

    regression: rows at the largest orders; seed: of the swarm; tolerance: T of the adapted BIC, µm or µm/m; safety:
    its ST; most: largest number of inputs in a model, None: any number.
    ValueError: fewer than two rows.
    """
    if len(regression.y) < 2:
        raise ValueError(f"{len(regression.y)} rows: expected at least 2 with all earlier outputs measured")
    window, lags = regression.window, regression.nb + 1
    n_inputs = window.u.shape[1]
    everything = Structure(0, tuple(range(n_inputs)), (regression.nb,) * n_inputs)
    x, y = regression.columns(everything)[:, 1:], regression.y
    grams, moments, energies, own, across = [], [], [], [], []
    for na in range(regression.na + 1):
        q, r = np.linalg.qr(regression.own[:, : 1 + na])
        back = np.linalg.pinv(r) @ q.T
        left, target = x - q @ (q.T @ x), y - q @ (q.T @ y)
        grams.append(left.T @ left + _RIDGE * len(y) * np.eye(x.shape[1]))
        moments.append(left.T @ target)
        energies.append(float(target @ target))
        own.append(_padded(back @ y, regression.na + 1))
        across.append(_padded(back @ x, regression.na + 1))
    draws = np.random.default_rng(seed).random((iterations + 1, swarm, 2, n_inputs + 2))
    log_share, orders, cost, gap = _kernel.pso(
        np.array(grams),
        np.array(moments),
        np.array(energies),
        np.array(own),
        np.array(across),
        np.ascontiguousarray(window.u),
        window.y,
        lags,
        CRITERIA.index(criterion),
        window.y_std,
        tolerance,
        safety,
        math.log(_LEAST_SHARE),
        n_inputs if most is None else most,
        draws,
        _PULL,
        *_INERTIA,
    )
    na, sizes = orders[0], [nb + 1 for nb in orders[1:]]
    columns = [s * lags + j for s, size in enumerate(sizes) for j in range(size)]
    lasso = GroupLasso(grams[na][np.ix_(columns, columns)], sizes)
    penalty = math.exp(log_share) * lasso.largest(moments[na][columns])
    active = lasso.solve(moments[na][columns], energies[na], penalty).active
    structure = Structure(na, active, tuple(sizes[s] - 1 for s in active))
    return Chosen(structure, cost, penalty, gap)


def _padded(array: FloatArray, rows: int) -> FloatArray:
    padded = np.zeros((rows, *array.shape[1:]))
    padded[: len(array)] = array
    return padded
