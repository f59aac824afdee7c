"""Simulated time for tests with a real device or control on the wire."""

import asyncio

from tests.benches.stepped_clock import SteppedClock

_LIMIT_S = 300.0
"""Real seconds for what goes over the wire in one period, and for what is computed meanwhile."""


class WireClock(SteppedClock):
    """Simulated time that also waits for what goes over a real wire."""

    async def rest(self) -> None:
        await super().rest()
        async with asyncio.timeout(_LIMIT_S):
            while self.holds:
                await asyncio.sleep(0.0005)
                await super().rest()
