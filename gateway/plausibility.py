"""Stated limits of one channel: range, rate of change, frozen value. Nothing is judged that was not stated."""

from dataclasses import dataclass, replace

from drivers.base import Quality, Reading

_WINDOW_S = 60.0
"""A rate is judged over a minute or more: one step of a sensor's resolution in a second is no rate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plausible:
    """Limits of one channel, in its unit. None: not judged."""

    smallest: float | None = None
    largest: float | None = None
    rate_per_min: float | None = None
    stuck_after_s: float | None = None


class Check:
    """Judges the readings of one channel, one after the other."""

    def __init__(self, limits: Plausible) -> None:
        self._limits = limits
        self._accepted: Reading | None = None
        """Last reading whose rate was plausible."""
        self._changed: Reading | None = None
        """First reading of the present number."""

    def judge(self, reading: Reading) -> Reading:
        """The reading, its quality lowered and `detail` set when a limit is broken. Bad readings pass unchanged."""
        if reading.quality not in (Quality.GOOD, Quality.SIMULATED):
            return reading
        stuck = self._stuck(reading)
        if broken := self._range(reading) or self._rate(reading):
            return replace(reading, quality=Quality.OUT_OF_RANGE, detail=broken)
        self._accepted = reading
        return replace(reading, quality=Quality.STALE, detail=stuck) if stuck else reading

    def _range(self, reading: Reading) -> str:
        limits, value = self._limits, reading.value
        if limits.smallest is not None and value < limits.smallest:
            return f"{value:g} is below the stated minimum, {limits.smallest:g}"
        if limits.largest is not None and value > limits.largest:
            return f"{value:g} is above the stated maximum, {limits.largest:g}"
        return ""

    def _rate(self, reading: Reading) -> str:
        rate, before = self._limits.rate_per_min, self._accepted
        if rate is None or before is None:
            return ""
        passed_s = max(reading.monotonic_s - before.monotonic_s, _WINDOW_S)
        change = abs(reading.value - before.value)
        if change <= rate * passed_s / 60.0:
            return ""
        return f"changed by {change:g} within {passed_s:.0f} s, more than the stated {rate:g} per minute"

    def _stuck(self, reading: Reading) -> str:
        if self._changed is None or reading.value != self._changed.value:
            self._changed = reading
        after_s, same_s = self._limits.stuck_after_s, reading.monotonic_s - self._changed.monotonic_s
        if after_s is None or same_s < after_s:
            return ""
        return f"exactly {reading.value:g} for {same_s:.0f} s"
