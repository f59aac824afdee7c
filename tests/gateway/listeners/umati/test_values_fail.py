"""What the OPC UA server cannot show is reported when that begins and when it ends."""

import asyncio
from datetime import UTC, datetime

import pytest

from gateway.listeners.umati.server import MachineToolServer
from gateway.listeners.umati.settings import OpcUaServing, ShownMachine
from gateway.telemetry.subscriber.site import SiteSeen
from tests.benches.stepped_clock import SteppedClock
from tests.benches.waits import LIMIT_S


class BreakableSite(SiteSeen):
    """A site whose values cannot be shown while it is broken."""

    def __init__(self) -> None:
        super().__init__("talc", ("mill",), lambda: datetime.now(UTC), self.looked_at)
        self.broken, self.looks = False, 0

    def looked_at(self) -> float:
        self.looks += 1
        if self.broken:
            raise ValueError("no such time")
        return 0.0

    async def some_looks(self, clock: SteppedClock) -> None:
        enough = self.looks + 3
        async with asyncio.timeout(LIMIT_S):
            while self.looks < enough:
                await clock.run_until(clock.monotonic() + 1.0)


@pytest.mark.slow  # the nodes of the standard take three seconds to make, in a process of low priority
async def test_values_that_cannot_be_shown_are_reported_once_with_the_traceback_and_when_they_are_shown_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock, site = SteppedClock(), BreakableSite()
    monkeypatch.setattr("gateway.listeners.umati.server.RealClock", lambda: clock)
    async with MachineToolServer(site, {"mill": ShownMachine()}, OpcUaServing(), "127.0.0.1", 0):
        await site.some_looks(clock)
        for broken in (True, False, True):
            site.broken = broken
            await site.some_looks(clock)
    said = [(r.message, r.exc_info is not None) for r in caplog.records if r.name == "gateway.listeners.umati.server"]
    assert said == [
        ("values could not be shown", True),
        ("values are shown again", False),
        ("values could not be shown", False),
    ]
    assert caplog.text.count("ValueError: no such time") == 1
