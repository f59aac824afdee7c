"""The latest reading of each channel, with its age: a stale value never looks fresh."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from drivers.base import Quality, Reading
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

STALE_AFTER_PERIODS = 3


@dataclass(frozen=True, slots=True)
class Aged:
    """A reading and its present age."""

    reading: Reading
    """The reading; `stale` and without a number if it was good and no newer one has come for three periods."""
    age_s: float


class Board:
    """Latest reading per channel.

    Parameters
    ----------
    periods_s: channel to its polling period, s. Only these channels are known.
    """

    def __init__(self, periods_s: Mapping[str, float]) -> None:
        self._periods = dict(periods_s)
        self._latest: dict[str, Reading] = {}
        self._expired: set[str] = set()
        """Channels whose latest reading `expire` has reported as stale."""

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of the configuration, in its order."""
        return tuple(self._periods)

    def put(self, readings: Iterable[Reading]) -> None:
        """Take newer readings. Raises KeyError for a channel that is not in the configuration."""
        for reading in readings:
            if reading.channel not in self._periods:
                raise KeyError(f"channel {reading.channel!r} is not in the configuration")
            self._latest[reading.channel] = reading
            self._expired.discard(reading.channel)

    def configure(self, periods_s: Mapping[str, float]) -> None:
        """Change the set of channels; the readings of those that remain are kept."""
        self._periods = dict(periods_s)
        self._latest = {channel: reading for channel, reading in self._latest.items() if channel in periods_s}
        self._expired &= self._latest.keys()

    def latest(self, channel: str, now_s: float) -> Aged | None:
        """The channel's state at monotonic `now_s`; None before its first reading.

        Raises KeyError for a channel that is not in the configuration.
        """
        stale_after_s = STALE_AFTER_PERIODS * self._periods[channel]
        reading = self._latest.get(channel)
        if reading is None:
            return None
        if _ages(reading) and now_s >= reading.monotonic_s + stale_after_s:
            reading = _stale(reading, now_s)
        return Aged(reading, max(0.0, now_s - reading.monotonic_s))

    def expire(self, now_s: float) -> tuple[list[Reading], float]:
        """The channels that have gone stale since the last call, as readings, and when to call again at the latest, s.

        Readings that arrive after this call cannot go stale before that moment.
        """
        gone: list[Reading] = []
        again_s = now_s + STALE_AFTER_PERIODS * min(self._periods.values(), default=1.0)
        for channel, reading in self._latest.items():
            stale_s = reading.monotonic_s + STALE_AFTER_PERIODS * self._periods[channel]
            if now_s < stale_s:
                if stale_s < again_s and _ages(reading):
                    again_s = stale_s
            elif channel not in self._expired and _ages(reading):
                self._expired.add(channel)
                gone.append(_stale(reading, now_s))
        return gone, again_s

    def snapshot(self, now_s: float) -> dict[str, Aged]:
        """Every channel that has been read, in the order of the configuration."""
        found = ((channel, self.latest(channel, now_s)) for channel in self._periods)
        return {channel: aged for channel, aged in found if aged is not None}


def _ages(reading: Reading) -> bool:
    """Whether the reading claims to be valid now; a bad reading does not go stale."""
    return reading.quality.usable


def _stale(reading: Reading, now_s: float) -> Reading:
    detail = Text(NoticeCode.NO_NEW_VALUE, for_s=now_s - reading.monotonic_s)
    r = reading
    return Reading(r.channel, math.nan, r.unit, Quality.STALE, r.source_time, r.monotonic_s, detail)
