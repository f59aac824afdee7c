"""Criteria for candidate models: the adapted BIC of Z22, and BIC. The kernel's swarm has them, AIC and MDL too."""

import math
from typing import Final, Literal

import numpy as np

from talc.frame import FloatArray

Criterion = Literal["adapted_bic", "bic", "aic", "mdl"]
CRITERIA: Final[tuple[Criterion, ...]] = ("adapted_bic", "bic", "aic", "mdl")
WORST: Final = 1e9
"""Cost of an unstable or impossible candidate: finite, so that a swarm can still compare."""


def adapted_bic(residual: FloatArray, orders: int, inputs: int, tolerance: float, safety: float) -> float:
    """ln(n) (orders + N²) + n ln(sum E²) max(1, max|E| / (ST T)) (Z22 eq. 9), guarded.

    residual: (n,) free-run residuals over the measured rows, µm or µm/m; orders: na + sum of nb_s; inputs: N;
    tolerance: T; safety: ST. The paper leaves open whether the bracket starts at T, which makes a jump, or at ST T, as
    here. Below a sum of 1 µm² the logarithm would turn negative and the bracket reward a violation: it is held at 0. So
    the unit matters: residuals in mm would all count as 0, and no input would be worth its price.
    A residual that is not finite costs 1e9. ValueError: no residuals.
    """
    n = _rows(residual)
    if not np.isfinite(residual).all():
        return WORST
    bracket = max(1.0, float(np.abs(residual).max()) / (safety * tolerance))
    fit = n * math.log(max(float(residual @ residual), 1.0)) * bracket
    return min(math.log(n) * (orders + inputs**2) + fit, WORST)


def bic(residual: FloatArray, parameters: int) -> float:
    """n ln(SSE / n) + d ln n (Schwarz 1978); d: estimated coefficients."""
    n = _rows(residual)
    if not np.isfinite(residual).all():
        return WORST
    return min(n * math.log(max(float(residual @ residual) / n, 1e-300)) + parameters * math.log(n), WORST)


def _rows(residual: FloatArray) -> int:
    if residual.size == 0:
        raise ValueError("residual is empty: expected at least one measured row")
    return int(residual.size)
