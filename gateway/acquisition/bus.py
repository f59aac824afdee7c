"""The acquisition's view of one bus: opened when its turn has come, and closed even if that raises."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager

from drivers.base import Bus, Driver, Learns, LimitedBus, SharedServer
from gateway.acquisition.line import Line
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.boundary import uncancelled
from gateway.runtime.breaker import Breaker

log = logging.getLogger(__name__)

_CLOSE_LIMIT_S = 5.0
"""Real seconds that closing a bus or device may take."""
_SETTLE_S = 5.0
"""How long a new connection may stay without an answer: some servers swallow what comes soon after connecting."""


class PolledBus:
    """The bus of a line, and whether it is open."""

    def __init__(self, line: Line) -> None:
        self.breaker = Breaker(line.period_s, line.period_s * line.retry_max_periods)
        self.is_open = False
        self.answers = False
        """Whether a device has been heard since it was opened."""
        self.was_mute = False
        """Whether nothing was heard on its last connection that was held for long: another one may be served, however
        long its devices are to be left alone."""
        self._opened_s = -math.inf
        self._bus, self._limit_s = line.bus, line.read_limit_s
        self.subject = Text(NoticeCode.BUS, name=line.bus.name)
        """Its name in reports."""
        self.learns = isinstance(line.bus, Learns)
        """Whether it finds out how its devices want to be asked."""
        self._shared = line.bus if isinstance(line.bus, SharedServer) else None
        self._limited = line.bus if isinstance(line.bus, LimitedBus) else None
        self.is_limited = self._limited is not None
        """Whether the bus can be told when the time for a request ends."""

    @contextmanager
    def limited(self, left_s: float) -> Iterator[None]:
        """Inside, no request waits for longer than this, if the bus can limit it. Raises what the bus raises."""
        if self._limited is None or left_s == math.inf:
            yield
            return
        self._limited.limit(left_s)
        try:
            yield
        finally:
            self._limited.limit(math.inf)

    def settles(self, now_s: float) -> bool:
        """Whether nothing can be concluded yet from the silence of its devices. now_s: monotonic"""
        return self.is_open and not self.answers and now_s - self._opened_s < _SETTLE_S

    def heard(self) -> None:
        """A device is heard."""
        self.answers, self.was_mute = True, False
        self.breaker.succeeded()

    async def open(self, now_s: float) -> None:
        """Open the bus; now_s: monotonic.

        Raises its errors, or TimeoutError after the line's `read_limit_s`; the bus is then closed.
        """
        try:
            async with asyncio.timeout(self._limit_s):
                await uncancelled(self._bus.connect())
        except Exception:
            await self.close()
            raise
        self.is_open, self.answers, self._opened_s = True, False, now_s

    async def end_period(self) -> None:
        """Leave its server to others, if the bus may be told."""
        if self.is_open and self._shared is not None:
            await _tried("end of the period", self._shared.end_period())

    async def close(self) -> None:
        """Close the bus, even if it is closed already."""
        self.is_open = False
        await close(self._bus)


async def close(what: Bus | Driver) -> None:
    """Close it; an error in closing is only logged."""
    await _tried(f"closing {what}", what.close())


async def _tried(what: str, closing: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(_CLOSE_LIMIT_S):
            await uncancelled(closing)
    except MemoryError:
        raise
    except Exception:
        log.debug("%s", what, exc_info=True)
