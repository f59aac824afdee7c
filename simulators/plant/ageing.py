"""Drift over days and weeks, and failing sensors. Every draw depends only on the seed and the hour."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simulators.plant.body import FloatArray

_HOUR_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ageing:
    """Slow drift of friction and of sensors. `Ageing(friction_sigma=0, sensor_K_per_100h=0)` has no drift."""

    friction_sigma: float = 0.08
    """Standard deviation of each loss's logarithm: the grease moves and the preload settles (choice)."""
    friction_tau_h: float = 150.0
    """Correlation time: about a week (choice)."""
    sensor_K_per_100h: float = 0.05  # noqa: N815
    """Random walk of each temperature channel, standard deviation after 100 h (choice; Pt100 and amplifier)."""


class Drift:
    """Factors of the losses and offsets of the channels at any time, interpolated linearly on an hourly grid."""

    def __init__(self, ageing: Ageing, seed: int, sources: int, channels: int) -> None:
        self._ageing, self._seed = ageing, seed
        start = np.random.default_rng([seed, 5]).standard_normal(sources)
        self._log = [ageing.friction_sigma * start]
        self._offset = [np.zeros(channels)]

    def friction(self, time_s: float) -> FloatArray:
        """(s,) factors of the losses; before the start, those at the start."""
        k, part = self._at(time_s)
        return np.asarray(np.exp(self._log[k] + part * (self._log[k + 1] - self._log[k])), dtype=np.float64)

    def offsets(self, time_s: float) -> FloatArray:
        """(c,) K."""
        k, part = self._at(time_s)
        return np.asarray(self._offset[k] + part * (self._offset[k + 1] - self._offset[k]), dtype=np.float64)

    def _at(self, time_s: float) -> tuple[int, float]:
        hours = max(time_s, 0.0) / _HOUR_S
        k = int(hours)
        while len(self._log) < k + 2:
            draw = np.random.default_rng([self._seed, 6, len(self._log)])
            keep = math.exp(-1 / self._ageing.friction_tau_h)
            fresh = self._ageing.friction_sigma * math.sqrt(1 - keep**2) * draw.standard_normal(self._log[0].size)
            self._log.append(keep * self._log[-1] + fresh)
            walk = self._ageing.sensor_K_per_100h / 10 * draw.standard_normal(self._offset[0].size)
            self._offset.append(self._offset[-1] + walk)
        return k, hours - k


class FailureKind(StrEnum):
    """How a sensor fails."""

    OPEN = "open"
    """Reads nothing: NaN."""
    STUCK = "stuck"
    """Keeps the value it had."""
    OFFSET = "offset"
    """Reads `by_K` too much: loose in its bore, or a bad contact in a two-wire line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A failure of one channel between two times since the start."""

    channel: str
    kind: FailureKind
    from_s: float
    until_s: float = math.inf
    by_K: float = 3.0  # noqa: N815
