"""IO-Link masters as the profiles in examples/io-link describe them, on another maker's Modbus server (pymodbus)."""

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.base import Driver, Quality, Reading
from drivers.build import make_device
from tests.benches.buses import make_bus
from tests.benches.free_port import free_port
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time

FOLDER = Path(__file__).parents[3] / "examples" / "io-link"


@asynccontextmanager
async def master(maker: str, words: Mapping[int, int], channels: int) -> AsyncIterator[tuple[ModbusTcpServer, Driver]]:
    """A server with these registers, and 0 in those around them, read with that maker's profile."""
    last = max(words) + 40
    memory = SimData(0, values=[words.get(address, 0) for address in range(last)], datatype=DataType.REGISTERS)
    port = free_port()
    bus = make_bus("tcp1", "modbus_tcp", {"host": "127.0.0.1", "port": port})
    names = {f"port{number + 1}": number for number in range(channels)}
    device = make_device("master", bus, str(FOLDER / f"{maker}.toml"), 1, names, {}, ManualClock())
    server = ModbusTcpServer(SimDevice(1, memory), address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    try:
        await bus.connect()
        await device.connect()
        yield server, device
    finally:
        await bus.close()
        await server.shutdown()  # type: ignore[no-untyped-call]


def told(readings: Sequence[Reading]) -> list[float | str]:
    """The value of a good channel, otherwise the reason."""
    assert all(r.quality in (Quality.GOOD, Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE) for r in readings)
    return [round(r.value, 6) if r.quality is Quality.GOOD else r.detail for r in readings]


async def test_ifm_says_of_each_port_whether_its_temperature_is_valid() -> None:
    ports = {1: (0x01, 234), 2: (0x01, -33), 3: (0x03, 234), 4: (0x05, 234), 5: (0x00, 0), 6: (0x09, 234)}
    ports |= {7: (0x21, 234), 8: (0x51, 215)}  # too short; wrong cycle time and output length, which do not matter
    words = {1000 * port + 1: status for port, (status, _) in ports.items()}
    words |= {1000 * port + 2: value & 0xFFFF for port, (_, value) in ports.items()}
    async with master("ifm", words, 8) as (server, device):
        assert told(await device.read()) == [
            23.4,
            -3.3,
            "no IO-Link device at the port",
            "the IO-Link device sends invalid process data",
            "the port is not set to IO-Link",
            "another IO-Link device than the one set",
            "the master's process data length is too short for the device",
            21.5,
        ]
        # A sensor is unplugged: the master keeps its last bytes, and only the status tells.
        await server.async_setValues(1, 16, 1001, [0x07])
        assert told(await device.read())[:2] == ["no IO-Link device at the port", -3.3]
        await server.async_setValues(1, 16, 1001, [0x01, 32764])
        assert told(await device.read())[0] == "the sensor has no data"
        await server.async_setValues(1, 16, 1002, [0xEA00])
        assert told(await device.read())[0] == "-563.2 degC is outside -50 to 150 degC", "its bytes are swapped"
        await server.async_setValues(1, 16, 1002, [235])
        assert told(await device.read())[0] == 23.5


async def test_turck_has_one_bit_of_validity_for_each_port() -> None:
    values = (234, -33, 0, 215, 1501, -501, 8191, -8192)
    words = {2 + 16 * i: (value << 2 & 0xFFFF) | i % 4 for i, value in enumerate(values)}  # with switching outputs
    words[1] = 0b01_01_01_01_01_00_11_01  # port 3 is not valid; the bits between mean something else
    async with master("turck", words, 8) as (server, device):
        invalid = "the process data of the port is not valid"
        out = ["150.1", "-50.1", "819.1", "-819.2"]
        assert told(await device.read()) == [
            23.4,
            -3.3,
            invalid,
            21.5,
            *(f"{value} degC is outside -50 to 150 degC" for value in out),
        ]
        await server.async_setValues(1, 16, 1, [0b00_00_00_00_01_10_10_10])
        assert told(await device.read()) == [invalid, invalid, invalid, 21.5, *[invalid] * 4]


async def test_comtrol_says_of_each_port_whether_it_communicates() -> None:
    ports = ((0x06, 234), (0x02, 234), (0x01, 0), (0x0E, 234))
    words = {999 + 1000 * i: status << 8 | 0x5A for i, (status, _) in enumerate(ports)}  # digital inputs below it
    words |= {1000 + 1000 * i: 0x1234 for i in range(4)}  # an event
    words |= {1001 + 1000 * i: value for i, (_, value) in enumerate(ports)}
    async with master("comtrol", words, 4) as (_, device):
        assert told(await device.read()) == [
            23.4,
            "the process data is not valid",
            "no communication with an IO-Link device",
            "the port reports a fault",
        ]


RAWS = (0, 1, 234, 0x0FFF, 0x7FFC, 0x7FFF, 0x8000, 0xEA00, 0xFFFF)
"""What a sensor, or a master without one, may leave in its register."""


async def test_ifm_no_port_is_good_unless_its_status_says_so() -> None:
    """Every status of its low byte, eight at a time: good is bit 0 without the others that matter."""
    words = {1000 * port + place: 0 for port in range(1, 9) for place in (1, 2)}
    async with master("ifm", words, 8) as (server, device):
        for value in (234, 0x7FFC, 0xEA00):
            for first in range(0, 0x100, 8):
                for port in range(1, 9):
                    await server.async_setValues(1, 16, 1000 * port + 1, [first + port - 1, value])
                for status, reading in zip(range(first, first + 8), await device.read(), strict=True):
                    is_good = status & 0x2F == 0x01 and value == 234
                    assert (reading.quality is Quality.GOOD) == is_good, (status, value, reading)
                    assert not is_good or reading.value == pytest.approx(23.4)


async def test_turck_no_port_is_good_without_its_bit() -> None:
    words = dict.fromkeys(range(1, 2 + 16 * 8), 0)
    async with master("turck", words, 8) as (server, device):
        for raw in RAWS:
            for port in range(8):
                await server.async_setValues(1, 16, 2 + 16 * port, [raw])
            degrees = (raw - (raw >> 15 << 16) >> 2) / 10
            for bits in range(0x100) if raw == 234 else (0x00, 0xFF, 0xA5):
                valid = sum(1 << 2 * port for port in range(8) if bits >> port & 1)
                await server.async_setValues(1, 16, 1, [valid | (0xAAAA if raw % 2 else 0)])
                for port, reading in enumerate(await device.read()):
                    is_good = bool(bits >> port & 1) and -50 <= degrees <= 150
                    assert (reading.quality is Quality.GOOD) == is_good, (raw, bits, port, reading)
                    assert not is_good or reading.value == pytest.approx(degrees)


async def test_comtrol_no_port_is_good_unless_it_communicates_and_is_valid() -> None:
    words = {999 + 1000 * port + place: 0 for port in range(4) for place in (0, 1, 2)}
    async with master("comtrol", words, 4) as (server, device):
        for value in (234, 0xEA00):
            for first in range(0, 0x100, 4):
                for port in range(4):
                    await server.async_setValues(1, 16, 999 + 1000 * port, [(first + port) << 8 | 0x5A, 0x1234, value])
                for status, reading in zip(range(first, first + 4), await device.read(), strict=True):
                    is_good = status & 0x0E == 0x06 and value == 234
                    assert (reading.quality is Quality.GOOD) == is_good, (status, value, reading)


async def test_an_absent_status_is_not_a_good_one() -> None:
    """The map of another master, or one port fewer: an absent status cannot say that a value is valid."""
    words = {1000 * port + place: 234 for port in (1, 2) for place in (2,)}
    words |= {1001: 0x01}
    async with master("ifm", words, 3) as (_, device):
        first, second, third = await device.read()
    assert told([first]) == [23.4]
    assert Quality.GOOD not in (second.quality, third.quality)
