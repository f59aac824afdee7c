"""Simulated time for emulated controls and devices."""

import asyncio
from datetime import UTC, datetime, timedelta

from tests.benches.idle_loop import idle


class ManualClock:
    """Simulated time that moves when the test says so."""

    def __init__(self, now: float = 0.0) -> None:
        self.now = now
        self._moved = asyncio.Event()

    def monotonic(self) -> float:
        return self.now

    def utc(self) -> datetime:
        return datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=self.now)

    async def sleep_until(self, monotonic_s: float) -> None:
        while self.now < monotonic_s:
            await self._moved.wait()

    def move_to(self, now: float) -> None:
        self.now = now
        self._moved.set()
        self._moved = asyncio.Event()

    async def pass_to(self, now: float) -> None:
        """Move to this time, and let everything that slept until then run."""
        self.move_to(now)
        await idle()
