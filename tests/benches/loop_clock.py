"""Simulated time for a process in which nothing goes over a wire."""

import asyncio
from collections.abc import Sized

from tests.benches.stepped_clock import SteppedClock


class LoopClock(SteppedClock):
    """Time goes on as soon as the event loop has nothing to do. There is no wire with bytes on their way."""

    async def _rest(self) -> None:
        ready: Sized = asyncio.get_running_loop()._ready  # type: ignore[attr-defined] # noqa: SLF001
        while True:
            await asyncio.sleep(0)
            if not ready:
                if not self.holds:
                    return
                await asyncio.sleep(0.0005)
