"""Builds the readings of one device: all channels of one read have the same times, unless their ages are known."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from math import isfinite, nan
from sys import float_info

from drivers.base import Clock, Quality, Reading
from drivers.faults import Fault
from drivers.text import Text

_ROUNDING = 4 * float_info.epsilon
_OLDEST_S = 86_400.0
"""A source that states year 1 or 1601 as its time has none: no reading is dated back by more than this."""


def total(one: float, other: float) -> float:
    """Their sum; 0 where only their rounding remains: 27315 * 0.01 - 273.15 is 0 degC, not 5.7e-14."""
    result = one + other
    return 0.0 if abs(result) < _ROUNDING * max(abs(one), abs(other)) else result


@dataclass(slots=True)
class ReadingMaker:
    """Makes readings of the values that one driver reads: adds units, times and qualities."""

    units: Mapping[str, str]
    """Unit of each channel."""
    clock: Clock

    def make(self, values: Mapping[str, float | Fault], ages_s: Mapping[str, float] | None = None) -> list[Reading]:
        """One reading per channel, in the order of `values`; a fault becomes NaN with the fault's quality.

        A value that is not a finite number also becomes a fault: only a number can be good.

        ages_s: how long ago each value was measured; None: now
        """
        utc, monotonic_s = self.clock.utc(), self.clock.monotonic()
        readings = []
        for channel, value in values.items():
            age_s = 0.0 if ages_s is None else min(ages_s[channel], _OLDEST_S)
            measured, measured_s = utc - timedelta(seconds=age_s), monotonic_s - age_s
            if not isinstance(value, Fault) and not isfinite(value):
                value = Fault(Quality.SENSOR_FAULT, Text("not_finite", value=value))
            number, quality, detail = (
                (nan, value.quality, value.detail) if isinstance(value, Fault) else (value, Quality.GOOD, "")
            )
            readings.append(Reading(channel, number, self.units[channel], quality, measured, measured_s, detail))
        return readings

    def make_aged(self, judged: Mapping[str, tuple[float | Fault, float]]) -> list[Reading]:
        """The same of values that come with their ages, s."""
        values = {name: value for name, (value, _) in judged.items()}
        return self.make(values, {name: age_s for name, (_, age_s) in judged.items()})
