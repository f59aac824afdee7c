"""Stated limits of one channel: range, spike, rate of change, frozen value. Only stated limits are judged."""

from dataclasses import replace

from drivers.base import Quality, Reading
from gateway.config.sections import Limits
from gateway.model.codes import NoticeCode
from gateway.model.text import NOTHING, Text

_WINDOW_S = 60.0
"""A rate is judged over a minute or more: one step of a sensor's resolution in a second is not a rate."""

_SAME_S = 0.05
"""A number that was measured within this many seconds of the last one is the same measurement, read again: the driver
tells its age (MQTT, plain CAN, OPC UA, timed TPDOs). It says nothing new about a spike."""


class Check:
    """Checks the readings of one channel, one after the other."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._accepted: Reading | None = None
        """Last reading whose rate was plausible."""
        self._settled: float | None = None
        """Last value that was not a spike."""
        self._suspected: float | None = None
        """Value of the previous reading, if it jumped; the next one shows whether it was a spike or a step."""
        self._changed: Reading | None = None
        """First reading with the present number."""
        self._last: Reading | None = None
        """The last measurement as it was judged."""

    def judge(self, reading: Reading) -> Reading:
        """The reading, with lowered quality and a `detail` when it breaks a limit. Bad readings pass unchanged."""
        if not reading.quality.usable:
            return reading
        last = self._last
        if last is not None and reading.value == last.value and abs(reading.monotonic_s - last.monotonic_s) < _SAME_S:
            return replace(reading, quality=last.quality, detail=last.detail)
        self._last = self._measured(reading)
        return self._last

    def _measured(self, reading: Reading) -> Reading:
        """The same for a new measurement."""
        stuck = self._stuck(reading)
        spike = self._spike(reading.value)
        if broken := self._range(reading) or spike or self._rate(reading):
            return replace(reading, quality=Quality.OUT_OF_RANGE, detail=broken)
        self._accepted = reading
        return replace(reading, quality=Quality.STALE, detail=stuck) if stuck else reading

    def _range(self, reading: Reading) -> Text:
        limits, value = self._limits, reading.value
        if limits.min is not None and value < limits.min:
            return Text(NoticeCode.BELOW_MINIMUM, value=value, min=limits.min)
        if limits.max is not None and value > limits.max:
            return Text(NoticeCode.ABOVE_MAXIMUM, value=value, max=limits.max)
        return NOTHING

    def _spike(self, value: float) -> Text:
        jump, settled, suspected = self._limits.max_jump, self._settled, self._suspected
        if jump is None:
            return NOTHING
        if (
            settled is None
            or abs(value - settled) <= jump
            or (suspected is not None and abs(value - suspected) <= jump)
        ):
            self._settled, self._suspected = value, None
            return NOTHING
        self._suspected = value
        return Text(NoticeCode.JUMPED, by=abs(value - settled), most=jump)

    def _rate(self, reading: Reading) -> Text:
        rate, before = self._limits.max_rate_per_min, self._accepted
        if rate is None or before is None:
            return NOTHING
        passed_s = max(reading.monotonic_s - before.monotonic_s, _WINDOW_S)
        change = abs(reading.value - before.value)
        if change <= rate * passed_s / 60.0:
            return NOTHING
        return Text(NoticeCode.CHANGED_FAST, by=change, within_s=passed_s, most=rate)

    def _stuck(self, reading: Reading) -> Text:
        if self._changed is None or reading.value != self._changed.value:
            self._changed = reading
        after_s, same_s = self._limits.stuck_after_s, reading.monotonic_s - self._changed.monotonic_s
        if after_s is None or same_s < after_s:
            return NOTHING
        return Text(NoticeCode.FROZEN, value=reading.value, for_s=same_s)
