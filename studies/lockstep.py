"""Many settings of B19's control on one load case at once: the same steps, the same rows, the same regressors.

What `talc.control.Controller` does with the method `models`, a fixed interval, fixed limits, kept inputs and ARX models
of orders 0 and 1 by weighted least squares. Every setting has the same inputs and true errors, and differs in when it
measures. So each step is one operation on all of them, and a training needs no rows: the moments of the rows that were
measured so far are kept, and a measurement adds to them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from talc.frame import BoolArray, FloatArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.settings import ControlSettings

_CALIBRATION, _COMPENSATION, _NO_GOOD = range(3)
_LEAST_SPREAD = 1e-6
_WORST_CONDITION = 1e12
"""Of a training's matrix, columns of unit length: beyond it the rows do not determine the coefficients."""


@dataclass(frozen=True, slots=True)
class Courses:
    """S settings, T steps, E errors that are measured."""

    errors: tuple[int, ...]
    """Positions among THERMAL_ERRORS."""
    estimate: FloatArray
    """(S, T, E) as `studies.loop.Course.estimate`; NaN before the first models."""
    used: BoolArray
    """(S, T) a measurement was made."""
    updates: NDArray[np.int64]
    """(S,) model updates after the calibration."""


def run_together(
    inputs: FloatArray, measured: FloatArray, settings: Sequence[ControlSettings], max_pole: float
) -> Courses:
    """The control with each of the settings, which have one calibration.

    inputs: (T, n); measured: (T, 9) what a measurement gives in each row, NaN throughout for an error that is never
    measured. An error whose new model has a pole of `max_pole` or more keeps its former one.
    ValueError: the settings differ in more than what is measured when; an input never changes in the calibration, or
    the rows do not determine a model.
    """
    calibration = _calibration(settings)
    if np.any(inputs[:calibration].std(axis=0) <= _LEAST_SPREAD):
        raise ValueError("an input does not change in the calibration: expected only inputs that do")
    errors = np.flatnonzero(np.isfinite(measured).all(axis=0))
    y_mean, y_std = measured[:, errors].mean(axis=0), measured[:, errors].std(axis=0)
    u_mean, u_std = inputs.mean(axis=0), inputs.std(axis=0)
    # Least squares with an intercept do not depend on the scale.
    u, y = (inputs - u_mean) / u_std, (measured[:, errors] - y_mean) / y_std
    fixed = settings[0]
    um = np.array([ERROR_UNITS[THERMAL_ERRORS[e]] == MICROMETRE for e in errors])
    limits = np.where(um, fixed.acl_fixed_um, fixed.acl_fixed_um_per_m) / y_std
    together = _Together(u, y, limits, settings, max_pole)
    together.run()
    return Courses(tuple(errors.tolist()), together.estimate * y_std + y_mean, together.used, together.trainings - 1)


def _calibration(settings: Sequence[ControlSettings]) -> int:
    first = settings[0]
    same = {(s.calibration_steps, s.acl_fixed_um, s.acl_fixed_um_per_m) for s in settings}
    if len(same) != 1 or any(
        s.policy != "fixed" or s.acl != "fixed" or s.calibration_interval_steps != 1 for s in settings
    ):
        raise ValueError(
            "settings: expected one calibration, measured at each step, fixed intervals, and the same fixed limits"
        )
    return first.calibration_steps


class _Moments:
    """Sums over the measured rows of S settings: x x', x y', y²; with the output before a row, z: x z', z², z y.

    x: (p,) 1, inputs, and their change since the row before. z is measured, or what was estimated at the time. Errors
    are independent.
    """

    def __init__(self, settings: int, p: int, errors: int) -> None:
        self.n = np.zeros(settings)
        self.xx = np.zeros((settings, p, p))
        self.xy, self.xz = np.zeros((2, settings, p, errors))
        self.yy, self.zz, self.zy = np.zeros((3, settings, errors))

    def add(self, of: BoolArray, x: FloatArray, y: FloatArray, z: FloatArray) -> None:
        """A row, the same for all settings in `of`: (S,). x: (p,); y: (E,); z: (S, E)."""
        z = z[of]
        self.n[of] += 1
        self.xx[of] += np.outer(x, x)
        self.xy[of] += np.outer(x, y)
        self.xz[of] += x[:, None] * z[:, None, :]
        self.yy[of] += y**2
        self.zz[of] += z**2
        self.zy[of] += z * y

    def of(self, s: NDArray[np.intp]) -> "_Moments":
        """Copies for some of the settings."""
        made = _Moments.__new__(_Moments)
        for name in ("n", "xx", "xy", "xz", "yy", "zz", "zy"):
            setattr(made, name, getattr(self, name)[s].copy())
        return made


class _Together:
    """The state of S settings in scaled units, and their courses."""

    def __init__(
        self, u: FloatArray, y: FloatArray, limits: FloatArray, settings: Sequence[ControlSettings], max_pole: float
    ) -> None:
        rows, n = u.shape
        many, errors = len(settings), y.shape[1]
        self._u, self._y, self._limits, self._max_pole = u, y, limits, max_pole
        change = np.diff(u, axis=0, prepend=u[:1])
        self._x = np.column_stack([np.ones(rows), u, change])
        self._subsets = _subsets(n)
        self._calibration = settings[0].calibration_steps
        self._interval = np.array([s.measurement_interval_steps for s in settings])
        self._apart = np.array([s.no_good_interval_steps for s in settings])
        self._count = np.array([s.no_good_measurements for s in settings])
        self._phase = np.full(many, _CALIBRATION)
        self._in_phase, self._last = np.zeros((2, many), dtype=np.int64)
        p = self._x.shape[1]
        self._moments = _Moments(many, p, errors)
        self._lowest, self._highest = np.full((many, errors), np.inf), np.full((many, errors), -np.inf)
        self._held = np.full((many, errors), np.nan)
        # The models: coefficients of x and of the output before, and bounds.
        self._theta, self._past = np.zeros((many, errors, p)), np.zeros((many, errors))
        self._has = np.zeros((many, errors), dtype=np.bool_)
        self._history = np.zeros((many, errors))
        self._u_low, self._u_high, self._u_before = np.zeros((3, many, errors, n))
        self._y_low, self._y_high = np.zeros((2, many, errors))
        self.estimate = np.full((many, rows, errors), np.nan)
        self.used = np.zeros((many, rows), dtype=np.bool_)
        self.trainings = np.zeros(many, dtype=np.int64)

    def run(self) -> None:
        """All steps."""
        asked = np.ones(len(self._phase), dtype=np.bool_)
        for k in range(len(self._u)):
            asked = self._step(k, asked)

    def _step(self, k: int, measured: BoolArray) -> BoolArray:
        """(S,) who measures in the next step."""
        n, y = self._u.shape[1], self._y[k]
        before = self._held.copy()
        if k >= self._calibration:
            u = np.clip(self._u[k], self._u_low, self._u_high)
            theta = self._theta
            value = theta[..., 0] + self._past * self._history
            value += np.einsum("sei,sei->se", theta[..., 1 : 1 + n], u)
            value += np.einsum("sei,sei->se", theta[..., 1 + n :], u - self._u_before)
            value = np.clip(value, self._y_low, self._y_high)
            self._u_before, self._history = u, np.where(measured[:, None], y, value)
            self.estimate[:, k] = np.where(self._has, value, before)
            beyond = (np.where(self._has, np.abs(y - value), 0.0) > self._limits).any(axis=1)
        else:
            beyond = np.zeros(len(measured), dtype=np.bool_)
        self._note(k, measured)
        self._in_phase[measured] += 1
        worse = measured & beyond & (self._phase == _COMPENSATION)
        self._phase[worse], self._in_phase[worse] = _NO_GOOD, 0
        if k == self._calibration - 1:
            learn = np.ones(len(measured), dtype=np.bool_)
        else:
            learn = (self._phase == _NO_GOOD) & (self._in_phase >= self._count)
        since = k + 1 - self._last
        asked: BoolArray = np.where(
            self._phase == _COMPENSATION, since >= self._interval, (since >= self._apart) & ~learn
        )
        if k < self._calibration:
            asked = np.ones(len(measured), dtype=np.bool_)
        if learn.any():
            self._train(k, np.flatnonzero(learn))
        return asked

    def _note(self, k: int, measured: BoolArray) -> None:
        """A row into the moments."""
        y = self._y[k]
        if k:
            before = np.where(self.used[:, k - 1, None], self._y[k - 1], self.estimate[:, k - 1])
            self._moments.add(measured, self._x[k], y, before)
        self.used[:, k] = measured
        self._last[measured], self._held[measured] = k, y
        self._lowest[measured] = np.minimum(self._lowest[measured], y)
        self._highest[measured] = np.maximum(self._highest[measured], y)

    def _train(self, k: int, s: NDArray[np.intp]) -> None:
        """New models for settings s: (B,), from the rows up to k, in which all of them measured."""
        self._adopt(k, s, *self._fit(self._moments.of(s)))

    def _fit(self, m: _Moments) -> tuple[FloatArray, FloatArray]:
        """Coefficients (B, E, p) of x and (B, E) of z, with the orders of least BIC."""
        p, (many, errors) = m.xx.shape[1], m.yy.shape
        gram = np.empty((many, errors, p + 1, p + 1))
        gram[..., :p, :p] = m.xx[:, None]
        gram[..., :p, p] = gram[..., p, :p] = m.xz.transpose(0, 2, 1)
        gram[..., p, p] = m.zz
        right = np.concatenate([m.xy.transpose(0, 2, 1), m.zy[..., None]], axis=-1)
        scale = np.sqrt(np.einsum("seii->sei", gram))
        gram /= scale[..., :, None] * scale[..., None, :]
        right /= scale
        if np.linalg.cond(gram[:, :, :p, :p][:, 0]).max() > _WORST_CONDITION:
            raise ValueError("the measured rows do not determine a model: expected inputs that change independently")
        best = np.full((many, errors), np.inf)
        theta = np.zeros((many, errors, p + 1))
        n = m.n[:, None]
        for columns in self._subsets:
            found = np.linalg.solve(gram[..., columns[:, None], columns], right[..., columns, None])[..., 0]
            squares = m.yy - np.einsum("sei,sei->se", found, right[..., columns])
            cost = n * np.log(np.maximum(squares / n, 1e-300)) + columns.size * np.log(n)
            better = cost < best
            best[better] = cost[better]
            whole = np.zeros_like(theta)
            whole[..., columns] = found
            theta[better] = whole[better]
        theta /= scale
        return theta[..., :p], theta[..., p]

    def _adopt(self, k: int, s: NDArray[np.intp], theta: FloatArray, past: FloatArray) -> None:
        stable = np.abs(past) < self._max_pole
        b, e = np.nonzero(stable)
        at = s[b], e
        self._theta[at], self._past[at], self._has[at] = theta[stable], past[stable], True
        seen = self._u[: k + 1]
        reach = np.ptp(seen, axis=0)
        self._u_low[at], self._u_high[at] = seen.min(axis=0) - reach, seen.max(axis=0) + reach
        swing = self._highest[at] - self._lowest[at]
        self._y_low[at], self._y_high[at] = self._lowest[at] - swing, self._highest[at] + swing
        # A measurement in this row has set the output.
        self._history[at], self._u_before[at] = self._y[k, e], self._u[k]
        self._phase[s], self._in_phase[s] = _COMPENSATION, 0
        self.trainings[s] += 1


def _subsets(n: int) -> list[NDArray[np.intp]]:
    """Columns of each order: na = 0, 1 and nb = 0, 1, as talc.papers.routes offers them."""
    level, change, past = np.arange(1 + n), np.arange(1 + n, 1 + 2 * n), np.array([1 + 2 * n])
    return [
        level,
        np.concatenate([level, change]),
        np.concatenate([level, past]),
        np.concatenate([level, change, past]),
    ]
