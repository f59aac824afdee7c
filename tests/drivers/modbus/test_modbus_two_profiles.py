"""One unit with several kinds of registers: a device for each, with its own profile."""

import asyncio
from pathlib import Path

import pytest

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.rtu_talk import frame, line

pytestmark = pytest.mark.simulated_time

PROFILE = """
protocol = "modbus"
title = "{title}"
buses = ["modbus_rtu"]
channels = 1
unit = "{unit}"
[value]
function = {function}
address = {address}
type = "{type}"
scale = {scale}
"""


def reply(request: bytes) -> bytes:
    """Unit 1: int16 at input register 100, float64 at holding register 4; every other address is refused."""
    match request[1], int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big"):
        case 4, 100, 1:
            return frame(bytes((1, 4, 2)) + (215).to_bytes(2, "big"))
        case 3, 4, 4:
            return frame(bytes.fromhex("01 03 08 3F F8 00 00 00 00 00 00"))
        case function, _, _:
            return frame(bytes((1, function | 0x80, 2)))


async def test_each_is_read_and_a_refused_address_takes_its_own_channels_only(tmp_path: Path) -> None:
    places = {
        "inlet": ("degC", 4, 100, "int16", 0.1),
        "flow": ("l/min", 3, 4, "float64", 1.0),
        "absent": ("degC", 4, 999, "int16", 0.1),
    }
    heard: list[Reading] = []
    notices: list[Notice] = []
    async with line() as (bus, peer):
        peer.reply = reply
        drivers = []
        for name, (unit, function, address, kind, scale) in places.items():
            path = tmp_path / f"{name}.toml"
            path.write_text(
                PROFILE.format(title=name, unit=unit, function=function, address=address, type=kind, scale=scale),
                encoding="utf-8",
            )
            drivers.append(make_device(name, bus, str(path), 1, {f"{name}_channel": 0}, {}, SystemClock()))
        async with Acquisition([Line(bus, tuple(drivers), 1.0)], RealClock(), heard.extend, notices.append):
            await asyncio.sleep(2.5)
    latest = {reading.channel: reading for reading in heard}
    assert latest["inlet_channel"].value == pytest.approx(21.5)
    assert latest["inlet_channel"].unit == "degC"
    assert (latest["flow_channel"].value, latest["flow_channel"].unit) == (1.5, "l/min")
    assert latest["absent_channel"].quality is Quality.COMM_FAULT
    assert "address 999, count 1 with exception 2: illegal data address" in latest["absent_channel"].detail
    assert [notice.subject for notice in notices] == ["device absent"]
