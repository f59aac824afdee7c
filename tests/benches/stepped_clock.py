"""A clock that stands still until the test moves it: the service's time without waiting."""

import asyncio
import heapq
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from itertools import count
from uuid import uuid4

from tests.benches.idle_loop import idle

EPOCH = datetime(2026, 3, 2, 6, 0, tzinfo=UTC)


class SteppedClock:
    """Implements ServiceClock. Time moves in `run_until` from one sleeper to the next, or by `spend`."""

    def __init__(self) -> None:
        self._now = 0.0
        self._utc_shift = timedelta()
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []
        self._number = count()
        self.holds = 0
        self.is_synchronised = True
        self.started_as = uuid4().hex

    def monotonic(self) -> float:
        return self._now

    def utc(self) -> datetime:
        return EPOCH + timedelta(seconds=self._now) + self._utc_shift

    async def sleep_until(self, monotonic_s: float) -> None:
        if monotonic_s <= self._now:
            await asyncio.sleep(0)
            return
        future = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (monotonic_s, next(self._number), future))
        await future

    @contextmanager
    def hold(self) -> Iterator[None]:
        self.holds += 1
        try:
            yield
        finally:
            self.holds -= 1

    def synchronised(self) -> bool:
        return self.is_synchronised

    def origin(self) -> str:
        return self.started_as

    def set_utc(self, utc: datetime) -> None:
        """Set the wall clock; the monotonic one goes on."""
        self._utc_shift = utc - EPOCH - timedelta(seconds=self._now)

    def spend(self, seconds: float) -> None:
        """A device that takes its time."""
        self._now += seconds

    async def run_until(self, monotonic_s: float) -> None:
        """Let time pass, waking every sleeper at its time."""
        await self.rest()
        while self._sleepers and self._sleepers[0][0] <= monotonic_s:
            at, _, future = heapq.heappop(self._sleepers)
            self._now = max(self._now, at)
            if not future.done():
                future.set_result(None)
            await self.rest()
        self._now = max(self._now, monotonic_s)

    async def rest(self) -> None:
        """Return when nothing more happens unless time advances; overridden where something else counts too."""
        await idle()
