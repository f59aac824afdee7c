"""Regressions fitted again at each measurement to all so far, and which of several ways was the best so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.recordings.methods import Given, MethodCourse
from studies import filled
from talc.frame import FloatArray
from talc.learner.learner import SPAN, TIME_CONSTANTS_S

_STRENGTHS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0, 1000.0)
"""Strengths of the ridge, in rows' worth of an input that is one span from its first value."""


class Regression(Protocol):
    """What `Refitted` fits. It never sees a measurement that had not been made."""

    def fit(self, x: FloatArray, y: FloatArray) -> None:
        """(r, p) features and (r, m) errors of all measurements so far, oldest first."""
        ...

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(w, q, m) in w ways for (q, p) features, of which the best so far is used; and the (q, m) standard deviation
        of the truth about it, NaN: not stated."""
        ...


@dataclass(frozen=True, slots=True)
class Features:
    """(T, p) deviations from the reference, and (T, p) the spans by which they are divided at each row.

    The reference is the first row, or that of each run where errors count from it anew. An input's span is what its
    description says or 3, as a temperature's of the learner, or its largest deviation so far. Lagged inputs pass
    through the learner's five lags.
    """

    deviation: FloatArray
    span: FloatArray

    @classmethod
    def of(cls, given: Given, kind: Literal["inputs", "lags"]) -> "Features":
        x = filled(given.inputs)
        x = x - x[0]
        least = np.array([SPAN if about.span is None else about.span for about in given.about])
        span = np.maximum(np.maximum.accumulate(np.abs(x), axis=0), least)
        reference = np.maximum.accumulate(np.where(given.new_reference, np.arange(len(x)), 0))
        if kind == "inputs":
            return cls(x - x[reference], span)
        constants = np.array(TIME_CONSTANTS_S)
        kept = np.where(constants > 0, np.exp(-given.step_s / np.maximum(constants, 1.0)), 0.0)
        lagged = np.zeros((*x.shape, len(constants)))
        for row, steps in enumerate(np.diff(given.k).tolist(), start=1):
            share = 1.0 - kept**steps
            lagged[row] = lagged[row - 1] + share * (x[row][:, None] - lagged[row - 1])
        lagged -= lagged[reference]
        return cls(lagged.reshape(len(x), -1), np.repeat(span, len(constants), axis=1))

    def at(self, rows: slice | NDArray[np.intp], now: int) -> FloatArray:
        """The features of some rows, over the spans that are known in row `now`."""
        return np.asarray(self.deviation[rows] / self.span[now])


@dataclass(frozen=True, slots=True)
class Refitted:
    """A regression, fitted again whenever the measurements have grown by a share."""

    name: str
    make: Callable[[], Regression]
    features: Literal["inputs", "lags"] = "lags"
    growth: float = 0.0
    """Fitted again when there are more than this share more measurements than at the last time."""
    levels: bool = True
    """Each way also with its level at the last measurement."""
    hindsight: bool = False
    """All ways are courses, of which the best is known afterwards only; otherwise the best so far of each error."""

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        features = Features.of(given, self.features)
        by_rows: dict[bytes, list[int]] = {}
        for e, measured in enumerate(given.measured.T):
            by_rows.setdefault(np.isfinite(measured).tobytes(), []).append(e)
        ways: list[FloatArray] = []
        sigma = np.full(given.measured.shape, np.nan)
        for errors in by_rows.values():
            found, sigma[:, errors] = self._forward(features, given.measured[:, errors])
            ways = ways or [np.full(given.measured.shape, np.nan) for _ in found]
            for way, estimate in zip(ways, found, strict=True):
                way[:, errors] = estimate
        if self.hindsight:
            return [MethodCourse(way, sigma) for way in ways]
        return [MethodCourse(best_so_far(np.stack(ways), given.measured), sigma)]

    def _forward(self, features: Features, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(w, T, m) of all ways, and (T, m) sigma. All m are measured in the same rows."""
        rows = np.flatnonzero(np.isfinite(measured[:, 0]))
        regression, fitted, at = self.make(), 0, 0
        found: FloatArray | None = None
        sigma = np.full(measured.shape, np.nan)
        for count, (row, end) in enumerate(zip(rows.tolist(), [*rows[1:].tolist(), len(measured) - 1], strict=True), 1):
            if not fitted or count > fitted * (1.0 + self.growth):
                fitted, at = count, row
                regression.fit(features.at(rows[:count], at), measured[rows[:count]])
            here = slice(row + 1, end + 1)
            estimate, stated = regression.predict(features.at(slice(row, end + 1), at))
            sigma[here] = stated[1:]
            last = measured[row] - estimate[:, :1]
            every = np.concatenate([estimate, estimate + last]) if self.levels else estimate
            if found is None:
                found = np.full((len(every), *measured.shape), np.nan)
            found[:, here] = every[:, 1:]
        return (np.full((1, *measured.shape), np.nan) if found is None else found), sigma


def best_so_far(ways: FloatArray, measured: FloatArray) -> FloatArray:
    """(T, m) of (w, T, m) estimates, for each error the one with the least squares at its (T, m) measurements before
    the row; the first one while there are none."""
    squares = np.nan_to_num((ways - measured) ** 2, nan=0.0)
    before = np.cumsum(squares, axis=1) - squares
    return np.asarray(np.take_along_axis(ways, before.argmin(axis=0)[None], axis=0)[0])


class RidgePath:
    """A linear regression in one way for each strength, with the mean of the measurements as its level."""

    def fit(self, x: FloatArray, y: FloatArray) -> None:
        self._x, self._y = x.mean(axis=0), y.mean(axis=0)
        u, size, v = np.linalg.svd(x - self._x, full_matrices=False)
        target = u.T @ (y - self._y)
        self._gains = np.stack([v.T @ (target * (size / (size**2 + s))[:, None]) for s in _STRENGTHS])

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        estimate = self._y + (x - self._x) @ self._gains
        return estimate, np.full(estimate.shape[1:], np.nan)


def ridges() -> tuple[Refitted, Refitted]:
    """On lagged inputs: as it can be used, and a bound."""
    return Refitted("ridge", RidgePath), Refitted("ridge, best in hindsight", RidgePath, hindsight=True)
