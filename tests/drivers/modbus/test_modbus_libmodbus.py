"""The Modbus drivers against a third-party slave: libmodbus (Debian package libmodbus5)."""

from collections.abc import AsyncIterator
from math import isnan
from pathlib import Path

import pytest

from drivers.base import Bus, NoAnswer, Quality, Reading, Refused, SystemClock
from drivers.build import make_device
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block
from tests.benches.asked_again import readings_of
from tests.benches.buses import make_bus
from tests.benches.libmodbus_line import TIMEOUT_S, libmodbus_line, slave

pytestmark = pytest.mark.peer


@pytest.fixture
async def rtu() -> AsyncIterator[Bus]:
    async with libmodbus_line() as bus:
        yield bus


@pytest.fixture
async def tcp() -> AsyncIterator[Bus]:
    with slave("tcp") as port:
        bus = make_bus("tcp1", "modbus_tcp", {"host": "127.0.0.1", "port": int(port), "timeout_s": TIMEOUT_S})
        await bus.connect()
        yield bus
        await bus.close()


def qualities(readings: list[Reading]) -> list[Quality]:
    return [reading.quality for reading in readings]


async def test_m7015_on_a_serial_line(rtu: Bus) -> None:
    channels = {f"c{i}": i for i in range(6)}
    driver = make_device("rtd", rtu, "icpdas_m7015", 3, channels, {}, SystemClock())
    await driver.connect()
    for _ in range(3):
        readings = list(await readings_of(driver))
        assert [r.value for r in readings if not isnan(r.value)] == pytest.approx([20.0, 21.3, -3.3, 40.0, 22.2])
        assert qualities(readings) == [Quality.GOOD] * 4 + [Quality.SENSOR_FAULT, Quality.GOOD]


async def test_adam6015_over_tcp(tcp: Bus) -> None:
    channels = {f"c{i}": i for i in range(7)}
    driver = make_device("rtd", tcp, "advantech_adam6015", 1, channels, {}, SystemClock())
    await driver.connect()
    for _ in range(3):
        readings = list(await driver.read())
        assert [r.value for r in readings][:5] == pytest.approx([50.0, 0.0, 100.0, -49.997, 149.997], abs=0.003)
        assert qualities(readings) == [Quality.GOOD] * 5 + [Quality.OUT_OF_RANGE, Quality.SENSOR_FAULT]


BLOCKS = """
protocol = "modbus"
title = "What the slave has in its four tables, and an input register that it lacks"
buses = ["modbus_rtu", "modbus_tcp"]
unit = "1"
[[block]]
function = 4
address = 0
channels = 7
type = "int16"
scale = 0.1
unit = "degC"
[[block]]
function = 2
address = 131
channels = 3
type = "bit"
[[block]]
function = 1
address = 268
type = "bit"
[[block]]
function = 3
addresses = [3, 256]
type = "uint16"
[[block]]
function = 3
address = 4
type = "uint32"
"""


async def test_four_tables_of_one_unit_with_an_address_that_it_lacks(rtu: Bus, tcp: Bus, tmp_path: Path) -> None:
    path = tmp_path / "blocks.toml"
    path.write_text(BLOCKS, encoding="utf-8")
    channels = {f"c{i}": i for i in range(14)}
    for bus, unit in ((rtu, 3), (tcp, 1)):
        driver = make_device("all", bus, str(path), unit, channels, {}, SystemClock())
        await driver.connect()
        for _ in range(3):
            *temperatures, lacking, before, open_input, after, coil, count, code, wide = await readings_of(driver)
            assert [r.value for r in temperatures] == pytest.approx([20.0, 21.3, -3.3, 40.0, 3276.7, 22.2])
            assert lacking.quality is Quality.COMM_FAULT
            assert "function 4, address 6, count 1 with exception 2" in lacking.detail
            assert [r.value for r in (before, open_input, after, coil, count, code)] == [0, 1, 0, 1, 1, 0x2E]
            assert wide.value == 0xFFFEFFFF


async def test_absent_unit_is_reported(rtu: Bus) -> None:
    """Its neighbour is not asked here: libmodbus takes the request after a foreign one for the foreign answer."""
    absent = make_device("absent", rtu, "icpdas_m7015", 4, {"a": 0}, {}, SystemClock())
    with pytest.raises(NoAnswer, match="unit 4"):
        await absent.read()


async def test_address_that_does_not_exist_is_refused(rtu: Bus, tcp: Bus) -> None:
    for bus, unit in ((rtu, 3), (tcp, 1)):
        assert isinstance(bus, ModbusBus)
        with pytest.raises(Refused, match="exception 2: illegal data address"):
            await bus.read("d", unit, Block(4, 6, 1))
        assert await bus.read("d", unit, Block(4, 0, 2)) == (200, 213)
