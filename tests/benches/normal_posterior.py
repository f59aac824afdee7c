"""The same models in closed form, as one dense normal distribution over all measurements; by SciPy, without filters."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]


def posterior(
    x: Array, steps: Array, y: Array, noise: float, prior: Array, growth: Array, at: Array, at_step: float
) -> tuple[float, float]:
    """Mean and variance of at' w at `at_step`, of y_k = x_k' w_k + e with w a random walk.

    x: (T, n); steps: (T,) of the measurements; noise: variance of e; prior: (n,) variance of w at steps[0];
    growth: (n,) per step.
    """
    shared = np.minimum(steps[:, None], steps[None, :]) - steps[0]
    among = (x * prior) @ x.T + shared * ((x * growth) @ x.T) + noise * np.eye(len(y))
    own = prior + growth * (at_step - steps[0])
    since = np.minimum(steps, at_step) - steps[0]
    across = (x * prior) @ at + since * ((x * growth) @ at)
    factor = cho_factor(among)
    mean = across @ cho_solve(factor, y)
    variance = at @ (own * at) - across @ cho_solve(factor, across)
    return float(mean), float(variance)
