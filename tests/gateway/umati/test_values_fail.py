"""What the OPC UA server cannot show is reported when that begins and when it ends."""

from datetime import UTC, datetime

import pytest

from gateway.heard import SiteSeen
from gateway.umati import OpcUaServing, ShownMachine
from gateway.umati.server import MachineToolServer
from tests.benches.waits import until


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

    async def some_looks(self) -> None:
        before = self.looks
        await until(lambda: self.looks >= before + 10)


async def test_values_that_cannot_be_shown_are_reported_once_with_the_traceback_and_when_they_are_shown_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("gateway.umati.server._EVERY_S", 0.01)
    caplog.set_level("WARNING")
    site = BreakableSite()
    async with MachineToolServer(site, {"mill": ShownMachine()}, OpcUaServing(), "127.0.0.1", 0):
        await site.some_looks()
        for broken in (True, False, True):
            site.broken = broken
            await site.some_looks()
    said = [(r.message, r.exc_info is not None) for r in caplog.records if r.name == "gateway.umati.server"]
    assert said == [
        ("values could not be shown", True),
        ("values are shown again", False),
        ("values could not be shown", False),
    ]
    assert caplog.text.count("ValueError: no such time") == 1
