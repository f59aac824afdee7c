"""Registers that are read once and then scale or judge every later value, over Modbus TCP, which has no checksum.

A changed byte in their answer is noticed.
"""

from pathlib import Path

import pytest

from drivers.base import BadAnswer, Bus, Driver, Quality, SystemClock
from drivers.build import make_device
from simulators.devices import Adam6015, TcpHost
from simulators.devices.adam6015 import PT100_150
from tests.benches.buses import make_bus
from tests.benches.rtu_talk import frame, line

pytestmark = pytest.mark.simulated_time

TRUE_DEGC = 30.0
SETTINGS = """
protocol = "modbus"
title = "A module with settings beside a counter"
buses = ["modbus_tcp", "modbus_rtu"]
unit = "degC"
max_gap = 8
[[block]]
function = 3
address = 20
channels = 1
type = "int16"
[[setting]]
function = 4
address = 0
equals = 1
name = "format"
hint = "set the format"
[[setting]]
function = 4
address = 4
equals = 1
name = "filter"
hint = "set the filter"
"""


class Spoilt:
    """One bit of the first code is changed in one of the answers about type codes, counted from 1."""

    def __init__(self, which: int) -> None:
        self.which, self.told = which, 0

    def __call__(self, _: int, answer: bytes) -> list[tuple[float, bytes]]:
        changed = bytearray(answer)
        if PT100_150.to_bytes(2, "big") in answer:
            self.told += 1
            if self.told == self.which:
                at = answer.index(PT100_150.to_bytes(2, "big"))
                changed[at + 1] ^= 1  # the code of another range, 0 to 100 degC
        return [(0.0, bytes(changed))]


async def until_connected(bus: Bus, driver: Driver) -> list[str]:
    """Connect; returns what went wrong before it succeeded."""
    said: list[str] = []
    while True:
        try:
            await bus.connect()
            await driver.connect()
            return said
        except BadAnswer as error:
            said.append(str(error))


@pytest.mark.parametrize("which", [1, 2])
async def test_a_changed_type_code_does_not_scale_a_channel(which: int) -> None:
    host = TcpHost({1: Adam6015(lambda: [TRUE_DEGC] * 7)})
    port = await host.start()
    bus = make_bus("bus1", "modbus_tcp", {"host": "127.0.0.1", "port": port})
    driver = make_device("adam", bus, "advantech_adam6015", 1, {"bearing": 0}, {}, SystemClock())
    try:
        host.spoil = Spoilt(which)
        said, *_ = await until_connected(bus, driver)
        assert "function 3, address 200" in said
        assert str(PT100_150) in said
        assert str(PT100_150 ^ 1) in said
        (reading,) = await driver.read()
        assert reading.quality is Quality.GOOD
        assert reading.value == pytest.approx(TRUE_DEGC, abs=0.01)
    finally:
        await driver.close()
        await bus.close()
        await host.stop()


class CountingUnit:
    """Its registers 0 and 4 are settings, 20 is a value, and the others count how often they are read."""

    silent = False

    def __init__(self) -> None:
        self.reads = 0

    def memory(self, function: int) -> dict[int, int]:
        self.reads += function == 4
        return dict.fromkeys(range(30), self.reads) | ({0: 1, 4: 1} if function == 4 else {20: 30})


async def test_a_register_that_changes_between_two_settings_is_no_disagreement(tmp_path: Path) -> None:
    (tmp_path / "counter.toml").write_text(SETTINGS)
    unit = CountingUnit()
    host = TcpHost({1: unit})
    port = await host.start()
    bus = make_bus("bus1", "modbus_tcp", {"host": "127.0.0.1", "port": port})
    driver = make_device("d", bus, str(tmp_path / "counter.toml"), 1, {"bearing": 0}, {}, SystemClock())
    try:
        assert await until_connected(bus, driver) == []
        assert unit.reads == 2
    finally:
        await driver.close()
        await bus.close()
        await host.stop()


async def test_frames_with_a_checksum_are_read_once(tmp_path: Path) -> None:
    (tmp_path / "counter.toml").write_text(SETTINGS)
    asked = []
    async with line() as (bus, peer):

        def reply(request: bytes) -> bytes:
            asked.append(request[1])
            return frame(bytes((1, request[1], 10, 0, 1, 0, 9, 0, 9, 0, 9, 0, 1)))

        peer.reply = reply
        driver = make_device("d", bus, str(tmp_path / "counter.toml"), 1, {"bearing": 0}, {}, SystemClock())
        await driver.connect()
    assert asked == [4]
