"""The latest reading of each channel, with its age: a stale value never looks fresh."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from drivers.base import Quality, Reading

STALE_AFTER_PERIODS = 3


@dataclass(frozen=True, slots=True)
class Aged:
    """A reading as it stands now."""

    reading: Reading
    """Its quality is `stale` when it was good once and no newer one has come for three periods."""
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

    def put(self, readings: Iterable[Reading]) -> None:
        """Take newer readings. KeyError: a channel that is not in the configuration."""
        for reading in readings:
            if reading.channel not in self._periods:
                raise KeyError(f"channel {reading.channel!r} is not in the configuration")
            self._latest[reading.channel] = reading

    def configure(self, periods_s: Mapping[str, float]) -> None:
        """Another set of channels; the readings of those that remain are kept."""
        self._periods = dict(periods_s)
        self._latest = {channel: reading for channel, reading in self._latest.items() if channel in periods_s}

    def latest(self, channel: str, now_s: float) -> Aged | None:
        """The channel as it stands at monotonic `now_s`; None before its first reading.

        KeyError: a channel that is not in the configuration.
        """
        period_s = self._periods[channel]
        reading = self._latest.get(channel)
        if reading is None:
            return None
        age_s = max(0.0, now_s - reading.monotonic_s)
        if age_s > STALE_AFTER_PERIODS * period_s and reading.quality in (Quality.GOOD, Quality.SIMULATED):
            reading = replace(reading, quality=Quality.STALE, detail=f"no new value for {age_s:.0f} s")
        return Aged(reading, age_s)

    def snapshot(self, now_s: float) -> dict[str, Aged]:
        """Every channel that has been read, in the order of the configuration."""
        found = ((channel, self.latest(channel, now_s)) for channel in self._periods)
        return {channel: aged for channel, aged in found if aged is not None}
