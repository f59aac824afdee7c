"""How much of what a model leaves is probing noise, and how fast the rest drifts: what a measurement is worth."""

import numpy as np
from numpy.typing import NDArray

from talc.frame import FloatArray
from talc.models import Disturbance

IntArray = NDArray[np.int64]

_SHORT, _LONG = 3, 24
"""Lags, in grid steps, between which the drift shows: noise is the same at both."""
_LEAST_PAIRS = 24


def disturbance_of(residual: FloatArray, steps: IntArray) -> Disturbance:
    """White noise and random walk from the structure function D(h) = mean (e[k+h] - e[k])² / 2 = noise² + q h / 2.

    residual: (n,) free-run residuals of training, µm or µm/m; steps: (n,) their grid steps, ascending.
    Too few pairs of measurements for both lags, or no noise: a measurement is taken whole (all zero).
    """
    near, far = _structure(residual, steps, 1, _SHORT), _structure(residual, steps, _LONG // 2, _LONG)
    if near is None or far is None:
        return Disturbance()
    (h_near, d_near), (h_far, d_far) = near, far
    # A drift smaller than the standard error of D at the long lag cannot be told from none: assume it is there, since
    # a model trusted too much never listens to a measurement again.
    hidden = d_near * np.sqrt(2.0 * h_far / len(residual))
    q = 2.0 * max(d_far - d_near, hidden) / (h_far - h_near)
    noise = max(0.0, d_near - q * h_near / 2.0)
    return Disturbance(pole=1.0, drift_std=float(np.sqrt(q)), noise_std=float(np.sqrt(noise)))


def _structure(residual: FloatArray, steps: IntArray, low: int, high: int) -> tuple[float, float] | None:
    """Mean lag and D over all pairs whose lag lies between `low` and `high`."""
    index = np.full(int(steps[-1] - steps[0]) + 1, np.nan)
    index[steps - steps[0]] = residual
    lags, squares = [], []
    for h in range(low, min(high, len(index) - 1) + 1):
        d = index[h:] - index[:-h]
        d = d[np.isfinite(d)]
        squares.append(d**2)
        lags.append(np.full(d.size, float(h)))
    every = np.concatenate(squares) if squares else np.zeros(0)
    if every.size < _LEAST_PAIRS:
        return None
    return float(np.concatenate(lags).mean()), float(every.mean() / 2.0)
