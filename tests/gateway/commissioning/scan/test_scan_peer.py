"""Scanning a host of another maker (modbus-serial) that refuses unknown units as it refuses unknown addresses."""

import pytest

from gateway.commissioning.scan.tcp import TcpScan, scan_hosts
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer


async def test_units_that_have_something_are_found_and_no_others() -> None:
    """Unit 1 has holding registers, units 2 and 3 input registers, unit 4 holding registers; unit 9 is silent."""
    async with running(node_with("modbus_serial", "modbus-serial"), "modbus_serial/server.js") as (port, _):
        there = TcpScan((("127.0.0.1", int(port)),), range(1, 9), timeout_s=30.0)
        report = await scan_hosts(there, lambda *_: None, lambda: False)
    assert [device.unit for device in report.found] == [1, 2, 3, 4]
    assert report.found[0].what.profile == "advantech_adam6015"
