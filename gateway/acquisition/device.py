"""The acquisition's view of one device: how it is read and judged, and what its channels show while it is silent."""

import asyncio
import math
from collections.abc import Sequence

from drivers.base import AsksLater, Driver, DriverError, Quality, Reading
from gateway.acquisition.bus import close
from gateway.acquisition.line import Line
from gateway.acquisition.plausibility import Check
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.boundary import uncancelled
from gateway.runtime.breaker import Breaker
from gateway.runtime.clocks import ServiceClock


class PolledDevice:
    """One driver of a line, its connection, and how it answered.

    Parameters
    ----------
    driver: one of the line's
    line: its limits and policy
    clock: real or simulated; gives a failure's times
    """

    def __init__(self, driver: Driver, line: Line, clock: ServiceClock) -> None:
        self.driver = driver
        self.subject = Text(NoticeCode.DEVICE, name=driver.device)
        """Its name in reports."""
        self.breaker = Breaker(line.period_s, line.period_s * line.retry_max_periods)
        self.cost_s = 0.0
        """How long its last failure took."""
        self.answered_s: float | None = None
        """How long its last answer took, without connecting; None if it did not answer the last request."""
        self.wavered_s = -math.inf
        """When it last failed to answer promptly."""
        self.error: Exception | None = None
        """The error of its last request; None if it answered."""
        self.ever_answered = False
        self.heard = False
        """Whether it was heard in this period: then it is not silent, even if none of its answers can be used."""
        self.lost = 0
        """In how many periods it was heard since it was last read."""
        self.silent = 0
        """In how many periods it was asked since it was last heard."""
        self.detail: str = Text(NoticeCode.NOT_ASKED_YET)
        """The same in words; for a device that was not asked, why it was not."""
        self._line, self._clock = line, clock
        self._asks_later = driver if isinstance(driver, AsksLater) else None
        self._connected = False
        self._units = dict.fromkeys(driver.channels, "")
        self._checks = {name: Check(limits) for name, limits in line.plausible.items() if name in self._units}

    async def read(self, *, again: bool = False) -> list[Reading]:
        """Its readings, each judged by the limits that the configuration states for its channel.

        again: it is asked once more in one period

        Raises the driver's errors, or TimeoutError after the line's `read_limit_s`.
        """
        began_s = self._clock.monotonic()
        try:
            async with asyncio.timeout(self._line.read_limit_s):
                await self._connect()
                asked_s = self._clock.monotonic()
                readings = self._complete(await uncancelled(self.driver.read(again=again)))
        except Exception as error:
            self._failed(began_s, error)
            raise
        self.answered_s, self.error = self._clock.monotonic() - asked_s, None
        self.ever_answered, self.heard, self.lost, self.silent = True, True, 0, 0
        self._units |= {reading.channel: reading.unit for reading in readings}
        return [self._judged(reading) for reading in readings]

    async def greet(self) -> None:
        """Connect it, if it is not. Raises as `read`."""
        began_s = self._clock.monotonic()
        try:
            async with asyncio.timeout(self._line.read_limit_s):
                await self._connect()
        except Exception as error:
            self._failed(began_s, error)
            raise

    async def _connect(self) -> None:
        if not self._connected:
            await uncancelled(self.driver.connect())
            self._connected = True

    def _failed(self, began_s: float, error: Exception) -> None:
        self.cost_s = self._clock.monotonic() - began_s
        self.answered_s, self.error = None, error
        self.heard |= isinstance(error, DriverError) and error.heard

    @property
    def asks_later(self) -> bool:
        """Whether its driver has left out something that is now due to be asked for again."""
        return self._connected and self._asks_later is not None and self._asks_later.asks_later

    async def ask_later(self) -> None:
        """Ask for it once. Raises as `read`."""
        if self._asks_later is None:
            return
        async with asyncio.timeout(self._line.read_limit_s):
            await uncancelled(self._asks_later.ask_later())

    def _complete(self, readings: Sequence[Reading]) -> Sequence[Reading]:
        """Raises AttributeError, TypeError or ValueError for a result that no driver may return, and that would
        otherwise end the gateway later."""
        found = [reading.channel for reading in readings]
        if sorted(found) != sorted(self._units):
            raise ValueError(f"the driver returned {found}, expected one reading each of {list(self._units)}")
        for reading in readings:
            if not isinstance(reading.quality, Quality):
                raise TypeError(f"quality of {reading.channel} is {reading.quality!r}")
            if not math.isfinite(reading.value) and reading.quality.usable:
                raise ValueError(f"{reading.channel} = {reading.value!r} of quality {reading.quality.value}")
        return readings

    def _judged(self, reading: Reading) -> Reading:
        check = self._checks.get(reading.channel)
        return reading if check is None else check.judge(reading)

    def fault(self) -> Sequence[Reading]:
        """What its channels show while it does not answer."""
        utc, now = self._clock.utc(), self._clock.monotonic()
        return [
            Reading(channel, math.nan, unit, Quality.COMM_FAULT, utc, now, self.detail)
            for channel, unit in self._units.items()
        ]

    async def close(self) -> None:
        """Close it; it is connected again before the next read."""
        if self._connected:
            self._connected = False
            await close(self.driver)
