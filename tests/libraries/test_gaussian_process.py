"""The learner's process against scikit-learn's."""

import numpy as np
import pytest

from talc.learner.experts import UNIT, Expert
from talc.learner.mixture import Mixture

INPUTS, LAGS, NOISE = 4, 2, 0.7
FEATURES = INPUTS * LAGS
REFERENCE = NOISE**2 / 5
"""Variance of the reference's noise."""


def test_scikit_learn_predicts_the_same() -> None:
    """Of a linear and smooth process without a level, away from the reference's condition, by another program."""
    from sklearn.gaussian_process import GaussianProcessRegressor  # a second that only this test needs to spend
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct

    draw = np.random.default_rng(3)
    walk = np.cumsum(draw.normal(size=(60, FEATURES)), axis=0) * 0.3
    x, at = walk[:50] - walk[0], walk[-1] - walk[0]
    y = 3.0 * x[:, 1] - x[:, 4] + draw.normal(0, NOISE, 50)
    y[0] = 0.0
    kernel = ConstantKernel(UNIT**2 / FEATURES, "fixed") * DotProduct(0.0, "fixed") + ConstantKernel(REFERENCE, "fixed")
    theirs = GaussianProcessRegressor(kernel, alpha=NOISE**2, optimizer=None).fit(x, y)
    mean, std = theirs.predict(at[None], return_std=True)
    mixture = Mixture(INPUTS, LAGS, 300.0, (Expert(1.0, 0.0),))
    for k, (row, value) in enumerate(zip(x, y, strict=True)):
        mixture.elapse(int(k > 0))
        mixture.learn(row, np.append(value, np.full(8, np.nan)), np.full(9, NOISE), np.zeros(9))
    ours, variance = mixture._each(at, 0, reference=True)  # noqa: SLF001 - of the process alone
    assert ours[0, 1] == pytest.approx(mean[0], rel=1e-6)
    assert variance[0, 1] == pytest.approx(std[0] ** 2, rel=1e-6)
