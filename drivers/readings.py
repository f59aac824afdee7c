"""Builds the readings of one device: all channels of one read have the same times."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan

from drivers.base import Clock, Quality, Reading
from drivers.faults import Fault


@dataclass(slots=True)
class ReadingMaker:
    """Adds times and sequence numbers to the values that one driver reads."""

    units: Mapping[str, str]
    """Of each channel."""
    clock: Clock

    def make(self, values: Mapping[str, float | Fault]) -> list[Reading]:
        """One reading per channel, in the order of `values`; a fault becomes NaN with the fault's quality.

        A value that is not a finite number also becomes a fault: only a number can be good.
        """
        utc, monotonic_s = self.clock.utc(), self.clock.monotonic()
        readings = []
        for channel, value in values.items():
            if not isinstance(value, Fault) and not isfinite(value):
                value = Fault(Quality.SENSOR_FAULT, f"the reading gives {value}, which is not a finite number")
            number, quality, detail = (
                (nan, value.quality, value.detail) if isinstance(value, Fault) else (value, Quality.GOOD, "")
            )
            readings.append(Reading(channel, number, self.units[channel], quality, utc, monotonic_s, detail))
        return readings
