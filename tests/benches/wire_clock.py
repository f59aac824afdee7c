"""Simulated time for tests with a real device or control on the wire."""

import asyncio

from tests.benches.stepped_clock import SteppedClock


class WireClock(SteppedClock):
    """Simulated time that also waits for what goes over a real wire."""

    async def rest(self) -> None:
        await super().rest()
        while self.holds:
            await asyncio.sleep(0.0005)
            await super().rest()
