"""Which sensor a hand warms, from what all of them have read lately."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Values: TypeAlias = NDArray[np.float64]

SPAN_S: Final = 30.0
"""What has risen is compared with so long ago: a hand warms a sensor within that time."""
_BEFORE, _NOW = 6, 3
"""Values whose median is what was before, and what is now."""
_FEWEST: Final = 10
_LEAST: Final[Mapping[str, float]] = {"degC": 0.5}
"""A smaller rise happens by itself, in K. Of other quantities only the noise is known."""
_NOISE: Final = 6.0
_APART: Final = 4.0
"""Rise, and distance from the second, in standard errors."""
_TIMES: Final = 2.0
"""The second rises at most by the leader's rise divided by this."""
_MANY: Final = 4
"""From so many sensors of one unit on, what most of them do is the hall or the machine, and no hand."""


@dataclass(frozen=True, slots=True)
class Track:
    """What one channel has read since it was last named."""

    times_s: Values
    """(n,), ascending, any origin."""
    values: Values
    """(n,)"""
    unit: str


@dataclass(frozen=True, slots=True)
class Warmed:
    """The channel that rose most, and the one after it. Rises are in the unit of the channel."""

    channel: str
    rise: float
    unit: str
    second: str = ""
    """Empty: none of this unit rose."""
    second_rise: float = 0.0
    rising: bool = False
    """Whether it rose far above its own noise."""
    clear: bool = False
    """Whether it is this one that was warmed: it is rising, and far before the second."""


@dataclass(frozen=True, slots=True)
class _Rise:
    channel: str
    unit: str
    rise: float
    error: float
    """Standard error of the rise."""

    @property
    def least(self) -> float:
        return max(_LEAST.get(self.unit, 0.0), _NOISE * self.error)

    @property
    def score(self) -> float:
        return self.rise / self.least


def warmed(tracks: Mapping[str, Track]) -> Warmed | None:
    """The leader among the channels; None: no channel has enough values yet, or none rises.

    A temperature has to rise; any other quantity (a gap, a voltage) to move.
    """
    rises = [found for name, track in tracks.items() if (found := _rise(name, track)) is not None]
    rises = _beside_the_others(rises)
    ranked = sorted((each for each in rises if each.rise > 0.0), key=lambda each: -each.score)
    if not ranked:
        return None
    first = ranked[0]
    second = next((each for each in ranked[1:] if each.unit == first.unit), None)
    others = [each for each in ranked[1:] if each.unit != first.unit]
    apart = second is None or (
        first.rise >= _TIMES * second.rise
        and first.rise - second.rise >= _APART * float(np.hypot(first.error, second.error))
    )
    rising = first.score >= 1.0
    clear = rising and apart and all(each.score <= first.score / _TIMES for each in others)
    name, rise = ("", 0.0) if second is None else (second.channel, second.rise)
    return Warmed(first.channel, first.rise, first.unit, name, rise, rising, clear)


def _rise(channel: str, track: Track) -> _Rise | None:
    since = int(np.searchsorted(track.times_s, track.times_s[-1] - SPAN_S)) if track.times_s.size else 0
    start = max(0, min(since, track.values.size - _FEWEST))
    values = track.values[start:]
    if values.size < _FEWEST:
        return None
    risen = float(np.median(values[-_NOW:]) - np.median(values[:_BEFORE]))
    error = _noise(track.values[:-_NOW], abs(risen)) * float(np.sqrt(1.57 * (1.0 / _BEFORE + 1.0 / _NOW)))  # of medians
    return _Rise(channel, track.unit, risen if track.unit in _LEAST else abs(risen), error)


def _noise(values: Values, risen: float) -> float:
    """Standard deviation of one value, from the differences of neighbours: a drift does not count. At least what the
    steps of the numbers leave unknown, unless the rise itself is one of few steps."""
    steps = np.abs(np.diff(values))
    nonzero = steps[steps > 0.0]
    if nonzero.size == 0:
        return 1e-9
    unknown = min(float(nonzero.min()), 0.1 * risen) / math.sqrt(12.0)
    return max(0.886 * float(steps.mean()), unknown)


def _beside_the_others(rises: Sequence[_Rise]) -> list[_Rise]:
    """Without what most sensors of a unit rise by. A fall of most does not count: they were warmed before, and cool."""
    common = {}
    for unit in {each.unit for each in rises}:
        all_rises = [each.rise for each in rises if each.unit == unit]
        common[unit] = max(0.0, float(np.median(all_rises))) if len(all_rises) >= _MANY else 0.0
    return [_Rise(each.channel, each.unit, each.rise - common[each.unit], each.error) for each in rises]
