"""Effects of loads on temperatures: loads heat with a lag, in proportion to a speed or power and to its square.

Each load r (its share of the largest that was learnt) enters as r and r² through first-order lags: the friction of a
bearing grows faster than its speed, and a body follows its heat with its own time constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from talc.frame import BoolArray, FloatArray
from talc.steps import DAY_S, HOUR_S, steps_in

LAGS_S: Final = (0.5 * HOUR_S, 4.0 * HOUR_S)
HISTORY_S: Final = DAY_S
"""How long before a window its lags begin: six of the longest."""
_HELD_S: Final = HOUR_S
"""An unknown load is as it was for an hour, then zero: mostly, the control is off."""
_PENALTY: Final = 0.01
"""Penalty of features with standard deviation 1."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadScale:
    """How loads become features."""

    names: tuple[str, ...]
    largest: FloatArray
    """(L,) magnitudes that were learnt, in the loads' own units; more than 0."""
    step_s: float
    """Grid step of the rows."""

    def features(self, loads: FloatArray, known: BoolArray) -> FloatArray:
        """(T, 4 L) lagged r and r² of consecutive rows (T, L). Before the first row the loads were as in it."""
        driving, kept = self._driving(loads, known), self._kept[:, None]
        found = np.empty((len(loads), len(LAGS_S), driving.shape[1]))
        level = np.repeat(driving[:1], len(LAGS_S), axis=0)
        for row, now in enumerate(driving):
            level = found[row] = kept * level + (1.0 - kept) * now
        return found.reshape(len(loads), -1)

    def last_features(self, loads: FloatArray, known: BoolArray) -> FloatArray:
        """(4 L,) the last row of `features`, without a loop over the rows."""
        ages = np.arange(len(loads))[::-1]
        weights = self._kept[:, None] ** ages
        weights[:, 1:] *= 1.0 - self._kept[:, None]  # the first row stands for all before it, too
        return np.asarray(weights @ self._driving(loads, known)).reshape(-1)

    def coming_features(self, last: FloatArray, loads: FloatArray, steps: int) -> FloatArray:
        """(steps, 4 L) what follows the features `last` (4 L,) if the loads are these (L,) from now on."""
        share = np.abs(loads) / self.largest
        driving = np.hstack([share, share**2])
        kept = self._kept[:, None] ** np.arange(1, steps + 1)[:, None, None]
        found = kept * last.reshape(len(LAGS_S), -1) + (1.0 - kept) * driving
        return np.asarray(found).reshape(steps, -1)

    @property
    def _kept(self) -> FloatArray:
        """Share of each lag's level that is left after a step."""
        return np.exp(-self.step_s / np.array(LAGS_S))

    def _driving(self, loads: FloatArray, known: BoolArray) -> FloatArray:
        share = np.abs(_held(loads, known, steps_in(_HELD_S, self.step_s))) / self.largest
        return np.hstack([share, share**2])


def scale_of(names: Sequence[str], loads: FloatArray, known: BoolArray, step_s: float) -> LoadScale | None:
    """The scale of the loads that changed within rows (T, L). None: no load changed."""
    moved = [i for i in range(len(names)) if known[:, i].any() and np.ptp(loads[known[:, i], i]) > 0.0]
    if not moved:
        return None
    largest = np.max(np.abs(np.where(known, loads, 0.0)[:, moved]), axis=0)
    return LoadScale(tuple(names[i] for i in moved), largest, step_s)


def _held(loads: FloatArray, known: BoolArray, steps: int) -> FloatArray:
    rows = np.arange(len(loads))[:, None]
    last = np.maximum.accumulate(np.where(known, rows, -steps - 1), axis=0)
    held = np.take_along_axis(loads, np.maximum(last, 0), axis=0)
    return np.where(rows - last <= steps, held, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LoadHeat:
    """What F features explain of m temperatures; F may be 0."""

    mean: FloatArray
    """(F,)"""
    weights: FloatArray
    """(F, m) K"""
    precision: FloatArray
    """(F, F) inverse of the features' covariance, for the leverage."""

    def explained(self, features: FloatArray) -> FloatArray:
        """(T, m) K, relative to the temperatures' mean."""
        return np.asarray((features - self.mean) @ self.weights)

    def leverage(self, features: FloatArray) -> FloatArray:
        """(T, 1) how far the loads (T, F) are from those that were learnt."""
        off = features - self.mean
        return np.asarray(np.sum(off @ self.precision * off, axis=1, keepdims=True))

    def part(self, keep: Sequence[int]) -> "LoadHeat":
        """The same for some of the temperatures."""
        return LoadHeat(self.mean, self.weights[:, keep], self.precision)


def heat_of(features: FloatArray, x: FloatArray) -> LoadHeat:
    """A ridge regression of temperatures (T, m) on features (T, F)."""
    mean, size = features.mean(axis=0), features.shape[1]
    off = features - mean
    spread = np.diag(off.T @ off) / max(len(off), 1)
    covariance = off.T @ off / max(len(off), 1) + np.diag(_PENALTY * spread + 1e-12)
    precision = np.linalg.inv(covariance) if size else np.empty((0, 0))
    weights = precision @ (off.T @ (x - x.mean(axis=0))) / max(len(off), 1)
    return LoadHeat(mean, weights, precision)
