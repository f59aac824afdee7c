"""Simulated time for tests with a real device or control on the wire, or with work in a thread."""

from tests.benches.idle_loop import idle
from tests.benches.stepped_clock import SteppedClock


class WireClock(SteppedClock):
    """Simulated time that also waits for whoever holds it."""

    async def rest(self) -> None:
        await idle(lambda: not self.holds)
