"""Methods of others: a Gaussian process that recalibrates itself, gradient boosting, online linear models.

Their libraries are imported when they are used: scikit-learn alone takes two seconds of a processor.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.recordings.methods import Given, Method, MethodCourse
from benchmarks.recordings.regressions import Features, Refitted
from talc.frame import BoolArray, FloatArray
from talc.indicators import TWO_SIDED_95
from talc.settings import LearnerSettings

_RENEWED = 0.5
"""The process' spans are found again when the measurements have grown by this share; in between it only takes the new
ones, which costs a hundredth."""


class Process:
    """An exact Gaussian process for each error: a squared exponential with a span for each input, and noise.

    Its parameters maximise the likelihood of all measurements.
    """

    def __init__(self) -> None:
        self._fitted: list[Any] = []
        self._renewed = 0

    def fit(self, x: FloatArray, y: FloatArray) -> None:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor

        renew = len(y) > self._renewed * (1.0 + _RENEWED)
        kernels = [_kernel(x.shape[1]) for _ in y.T] if renew else [each.kernel_ for each in self._fitted]
        self._renewed = len(y) if renew else self._renewed
        self._fitted = [
            GaussianProcessRegressor(kernel, optimizer="fmin_l_bfgs_b" if renew else None, normalize_y=True)
            for kernel in kernels
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # an input that does not matter has no longest span
            for each, errors in zip(self._fitted, y.T, strict=True):
                each.fit(x, errors)

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = [each.predict(x, return_std=True) for each in self._fitted]
        mean, sigma = (np.column_stack(columns) for columns in zip(*found, strict=True))
        noise = [each.kernel_.k2.noise_level * float(each._y_train_std) ** 2 for each in self._fitted]  # noqa: SLF001
        return mean[None], np.sqrt(np.maximum(sigma**2 - noise, 0.0))


def _kernel(features: int) -> Any:
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    return ConstantKernel(1.0, (1e-3, 1e3)) * RBF(np.ones(features), (1e-2, 1e3)) + WhiteKernel(0.01, (1e-6, 1.0))


@dataclass(frozen=True, slots=True)
class Recalibrated:
    """A Gaussian process of the present inputs that measures when its standard deviation exceeds a threshold.

    After Kaftan, Mayr, Porquez, Pomodoro, Trombert, Wegener and Bambach, CIRP Journal of Manufacturing Science and
    Technology 61 (2025) 400-409, from their description.
    """

    name: str = "Gaussian process"
    _refitted: Refitted = field(default=Refitted("", Process, "inputs", levels=False))

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        return self._refitted.courses(given)

    def decide(self, given: Given, limit: float) -> tuple[MethodCourse, BoolArray]:
        """Measured in a row whose half-width of the 95 % interval is beyond the limit; a beginning like the others'."""
        features, process = Features.of(given, "inputs"), Process()
        limits = np.where(given.angle, _ANGLE_SHARE * limit, limit)
        estimate, sigma = np.full((2, *given.measured.shape), np.nan)
        available = np.asarray(np.isfinite(given.measured).all(axis=1))
        dense, made, run = given.on_steps < given.dense_steps, np.zeros(len(available), dtype=np.bool_), -1
        for row in range(len(available)):
            due = bool(dense[row]) or (given.measure_first and int(given.run[row]) != run) or not made.any()
            if made.any():
                at = int(np.flatnonzero(made)[-1])
                ways, stated = process.predict(features.at(slice(row, row + 1), at))
                estimate[row], sigma[row] = ways[0, 0], stated[0]
                due = due or bool((TWO_SIDED_95 * sigma[row] > limits).any())
            made[row] = due and available[row]
            if made[row]:
                run = int(given.run[row])
                process.fit(features.at(np.flatnonzero(made), row), given.measured[made])
        return MethodCourse(estimate, sigma), made


_ANGLE_SHARE = LearnerSettings().limit_um_per_m / LearnerSettings().limit_um


class Boosting:
    """Gradient boosting of regression trees, one for each error, with scikit-learn's parameters."""

    def fit(self, x: FloatArray, y: FloatArray) -> None:
        from sklearn.ensemble import HistGradientBoostingRegressor

        self._fitted = [HistGradientBoostingRegressor(min_samples_leaf=5).fit(x, errors) for errors in y.T]

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        estimate = np.column_stack([each.predict(x) for each in self._fitted])
        return estimate[None], np.full(estimate.shape, np.nan)


class Online:
    """River's linear models: by stochastic gradients at two rates, and Bayesian; they take each measurement once."""

    def __init__(self) -> None:
        self._seen = 0
        self._models: list[list[Any]] = []

    def fit(self, x: FloatArray, y: FloatArray) -> None:
        from river import linear_model, optim

        if not self._models:
            makes = (
                partial(linear_model.LinearRegression, optimizer=optim.SGD(0.01)),
                partial(linear_model.LinearRegression, optimizer=optim.SGD(0.1)),
                linear_model.BayesianLinearRegression,
            )
            self._models = [[make() for _ in y.T] for make in makes]
        for features, errors in zip(x[self._seen :], y[self._seen :], strict=True):
            named = dict(enumerate(features.tolist()))
            for models in self._models:
                for model, value in zip(models, errors.tolist(), strict=True):
                    model.learn_one(named, value)
        self._seen = len(y)

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        named = [dict(enumerate(features.tolist())) for features in x]
        estimate = np.array([[[m.predict_one(one) for m in models] for one in named] for models in self._models])
        return estimate, np.full(estimate.shape[1:], np.nan)


def peers() -> tuple[Method, ...]:
    """All of them; river's only where it is installed, as for `make bench`."""
    boosting = Refitted("boosting", Boosting, growth=0.25)
    online = (Refitted("river", Online),) if find_spec("river") else ()
    return Recalibrated(), boosting, *online
