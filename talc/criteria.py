"""What a candidate model costs: the adapted BIC of Z22."""

import math

import numpy as np

from talc.frame import FloatArray


def adapted_bic(residual: FloatArray, orders: int, inputs: int, tolerance: float, safety: float) -> float:
    """ln(n) (orders + N²) + n ln(sum E²) max(1, max|E| / (ST T)) (Z22 eq. 9), guarded.

    residual: (n,) free-run residuals over the measured rows, µm or µm/m; orders: na + sum of nb_s; inputs: N;
    tolerance: T; safety: ST. The paper leaves open whether the bracket starts at T, which makes a jump, or at ST T, as
    here. Below a sum of 1 the logarithm would turn negative and the bracket reward a violation: it is held at 0.
    A residual that is not finite costs 1e9. ValueError: no residuals.
    """
    n = residual.size
    if n == 0:
        raise ValueError("residual is empty: expected at least one measured row")
    if not np.isfinite(residual).all():
        return 1e9
    bracket = max(1.0, float(np.abs(residual).max()) / (safety * tolerance))
    fit = n * math.log(max(float(residual @ residual), 1.0)) * bracket
    return min(math.log(n) * (orders + inputs**2) + fit, 1e9)
