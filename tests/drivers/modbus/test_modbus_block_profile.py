"""A device with several kinds of values, as the documentation describes one; and addresses that it refuses."""

import re
import struct
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.base import Driver, Quality, Reading, Refused, SetupError
from drivers.build import make_device
from drivers.profiles import load_profile
from simulators.devices.modbus_unit import ModbusUnit
from tests.benches.buses import make_bus
from tests.benches.free_port import free_port
from tests.benches.manual_clock import ManualClock
from tests.benches.own_profile import by_own_profile
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

METER = Path(__file__).parents[3] / "examples" / "profiles" / "meter.toml"


def meter_profile() -> str:
    """The example of the documentation."""
    return METER.read_text(encoding="utf-8")


@dataclass
class Meter:
    """What the example describes: registers and bits by function and address. It refuses all others."""

    volts: list[float] = field(default_factory=lambda: [230.5, 231.25, 229.0])
    watts: list[int] = field(default_factory=lambda: [15000, -22])
    alarms: list[int] = field(default_factory=lambda: [0, 1, 0, 0])
    word: int = 0b1_0000
    lacks: set[tuple[int, int]] = field(default_factory=set)
    asked: list[int] = field(default_factory=list)
    """Functions of the requests."""
    refusals: int = 0
    """This many requests are refused, whatever they are for."""
    silent: bool = False

    def memory(self, function: int) -> Mapping[int, int]:
        self.asked.append(function)
        if self.refusals:
            self.refusals -= 1
            return {}
        words: dict[int, int] = {}
        if function == 4:
            words = dict(enumerate(struct.unpack(">6H", struct.pack(">3f", *self.volts))))
        if function == 3:
            for address, watts in zip((4000, 4017), self.watts, strict=True):
                high, low = struct.unpack(">HH", struct.pack(">i", watts))
                words |= {address: low, address + 1: high}
            words[4100] = self.word
        if function == 2:
            words = {16 + i: bit for i, bit in enumerate(self.alarms)}
        return {address: word for address, word in words.items() if (function, address) not in self.lacks}


CHANNELS = {f"c{number}": number for number in range(11)}


def reading(
    meter: ModbusUnit,
    folder: Path,
    text: str = "",
    channels: Mapping[str, int] = CHANNELS,
    clock: ManualClock | None = None,
) -> AbstractAsyncContextManager[Driver]:
    return by_own_profile(meter, folder, text or meter_profile(), channels, clock or ManualClock())


def values(readings: list[Reading]) -> list[float]:
    return [reading.value for reading in readings if reading.quality is Quality.GOOD]


def faults(readings: list[Reading]) -> dict[str, tuple[str, str]]:
    return {r.channel: (r.quality.value, r.detail) for r in readings if r.quality is not Quality.GOOD}


async def test_every_kind_is_read_with_its_own_unit_and_rules(tmp_path: Path) -> None:
    meter = Meter()
    async with reading(meter, tmp_path) as driver:
        await driver.connect()
        readings = list(await driver.read())
        assert values(readings) == pytest.approx([230.5, 231.25, 229.0, 1500.0, -2.2, 0, 1, 0, 0, 0, 1])
        assert [r.unit for r in readings] == ["V"] * 3 + ["W"] * 2 + ["1"] * 6
        meter.volts, meter.word = [-1.0, 400.0, 230.0], 0b0_1000
        readings = list(await driver.read())
    assert faults(readings) == {
        "c0": ("sensor_fault", "phase missing"),
        "c1": ("out_of_range", "400 V is outside 0 to 300 V"),
    }
    assert values(readings)[-2:] == [1, 0]


async def test_requests_are_joined_within_one_function(tmp_path: Path) -> None:
    meter = Meter()
    async with reading(meter, tmp_path) as driver:
        await driver.connect()
        meter.asked.clear()
        await driver.read()
    assert meter.asked == [2, 3, 3, 3, 4], "4000, 4017 and 4100 are farther apart than max_gap"


async def test_refused_address_takes_its_own_channel_and_is_named(tmp_path: Path) -> None:
    meter = Meter(lacks={(2, 18), (4, 2)})
    async with reading(meter, tmp_path) as driver:
        await driver.connect()
        found = list(await driver.read())
        assert values(found) == pytest.approx([230.5, 229.0, 1500.0, -2.2, 0, 1, 0, 0, 1])
        hint = "does the profile fit the device?"
        assert faults(found) == {
            "c1": (
                "comm_fault",
                f"unit 1 answered function 4, address 2, count 2 with exception 2: illegal data address ({hint})",
            ),
            "c7": (
                "comm_fault",
                f"unit 1 answered function 2, address 18, count 1 with exception 2: illegal data address ({hint})",
            ),
        }
        assert isnan(found[1].value)
        for _ in range(3):
            meter.asked.clear()
            assert faults(list(await driver.read())).keys() == {"c1", "c7"}
            assert meter.asked == [2, 2, 3, 3, 3, 4, 4], "what is refused is left out, the rest is joined"


async def test_function_that_the_unit_does_not_have_takes_its_channels_only(tmp_path: Path) -> None:
    meter = Meter(lacks={(2, 16 + i) for i in range(4)})
    async with reading(meter, tmp_path) as driver:
        found = list(await driver.read())
        assert faults(found).keys() == {"c5", "c6", "c7", "c8"}
        meter.asked.clear()
        await driver.read()
    assert meter.asked == [3, 3, 3, 4]


async def test_refused_address_is_asked_for_again_after_a_minute_and_after_reconnecting(tmp_path: Path) -> None:
    meter, clock = Meter(lacks={(4, 2)}), ManualClock()
    async with reading(meter, tmp_path, clock=clock) as driver:
        assert faults(list(await driver.read())).keys() == {"c1"}
        meter.lacks.clear()
        clock.move_to(50.0)
        assert faults(list(await driver.read())).keys() == {"c1"}
        clock.move_to(61.0)
        assert faults(list(await driver.read())) == {}
        meter.lacks.add((4, 4))
        assert faults(list(await driver.read())).keys() == {"c2"}
        meter.lacks.clear()
        await driver.close()
        await driver.connect()
        assert faults(list(await driver.read())) == {}


async def test_single_refusal_is_not_believed(tmp_path: Path) -> None:
    """On a serial line it may be the late one of another request."""
    meter = Meter()
    async with reading(meter, tmp_path) as driver:
        meter.refusals = 1
        assert faults(list(await driver.read())) == {}
        meter.refusals = 3
        assert faults(list(await driver.read())) == {}, "three of what has been answered before"


async def test_all_refused_is_an_error_and_costs_one_request(tmp_path: Path) -> None:
    meter = Meter(lacks={(4, 2 * i) for i in range(3)})
    async with reading(meter, tmp_path, channels={f"c{i}": i for i in range(3)}) as driver:
        await driver.connect()
        with refusing(
            Refused,
            "modbus_unit_refused modbus_request function=4 address=0 count=6 "
            "modbus_exception code=2 modbus_illegal_address profile_fits",
        ):
            await driver.read()
        for _ in range(3):
            meter.asked.clear()
            with pytest.raises(Refused):
                await driver.read()
            assert meter.asked == [4]
        meter.lacks.clear()
        assert values(list(await driver.read())) == [230.5, 231.25, 229.0]


async def test_device_that_refuses_gaps_is_read_in_parts(tmp_path: Path) -> None:
    """Its profile allows gaps that the device does not have."""
    meter = Meter()
    async with reading(meter, tmp_path, meter_profile().replace("max_gap = 4", "max_gap = 120")) as driver:
        for _ in range(3):
            meter.asked.clear()
            assert faults(list(await driver.read())) == {}
    assert meter.asked == [2, 3, 3, 3, 4]


BITS = """
protocol = "modbus"
title = "Somebody's contacts"
buses = ["modbus_tcp"]
unit = "1"
[[block]]
function = 3
address = 10
channels = 5
type = "bit"
bit = 13
[[block]]
function = 3
address = 10
channels = 3
type = "bit"
bit = 1
stride = 12
[[block]]
function = 3
addresses = [12, 10]
type = "bit"
bit = 15
[[block]]
function = 3
address = 12
type = "uint16"
[[block.sentinel]]
raw = 32768
quality = "sensor_fault"
detail = "the first counts"
[[block.sentinel]]
raw = 32768
quality = "out_of_range"
detail = "not this"
"""


class Contacts:
    """Three registers."""

    silent = False

    def memory(self, function: int) -> Mapping[int, int]:
        return {10: 0b1010_0000_0000_0010, 11: 0b0000_0010_0000_0010, 12: 0x8000} if function == 3 else {}


async def test_bits_go_on_in_the_next_register(tmp_path: Path) -> None:
    async with reading(Contacts(), tmp_path, BITS) as driver:
        await driver.connect()
        readings = list(await driver.read())
    assert values(readings) == [*(1, 0, 1, 0, 1), *(1, 1, 1), *(1, 1)]
    assert faults(readings) == {"c10": ("sensor_fault", "the first counts")}


async def test_bits_of_a_register_whose_bytes_are_exchanged(tmp_path: Path) -> None:
    exchanged = BITS.replace('type = "bit"\nbit = 13', 'type = "bit"\nbyte_order = "little"\nbit = 5', 1)
    async with reading(Contacts(), tmp_path, exchanged) as driver:
        await driver.connect()
        readings = list(await driver.read())
    assert values(readings)[:5] == [1, 0, 1, 0, 1], "bits 13 to 15, then 0 and 1, as they lie in the register"


async def test_numbers_that_another_program_encodes(tmp_path: Path) -> None:
    """pymodbus' server, without phase 2; it keeps bits in registers of 16."""
    holding = [
        SimData(4000, values=[0x3A98, 0x0000], datatype=DataType.REGISTERS),  # 15000, its low word first
        SimData(4017, values=[0xFFEA, 0xFFFF], datatype=DataType.REGISTERS),
        SimData(4100, values=0b1_0000, datatype=DataType.UINT16),
    ]
    inputs = [SimData(0, values=230.5, datatype=DataType.FLOAT32), SimData(4, values=229.0, datatype=DataType.FLOAT32)]
    bits = [SimData(16, values=[False, True, False], datatype=DataType.BITS)]
    device = SimDevice(1, ([SimData(0, values=[False], datatype=DataType.BITS)], bits, holding, inputs))
    port = free_port()
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    path = tmp_path / "meter.toml"
    path.write_text(meter_profile(), encoding="utf-8")
    bus = make_bus("tcp1", "modbus_tcp", {"host": "127.0.0.1", "port": port})
    driver = make_device("meter", bus, str(path), 1, CHANNELS, {}, ManualClock())
    try:
        await bus.connect()
        await driver.connect()
        for _ in range(3):
            readings = list(await driver.read())
            assert faults(readings).keys() == {"c1"}
            assert values(readings) == pytest.approx([230.5, 229.0, 1500.0, -2.2, 0, 1, 0, 0, 0, 1])
    finally:
        await bus.close()
        await server.shutdown()  # type: ignore[no-untyped-call]


SHORT = """
protocol = "modbus"
title = "t"
buses = ["modbus_tcp"]
unit = "degC"
{}
"""
BLOCK = "[[block]]\nfunction = 3\naddress = 0\ntype = 'int16'\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "value: missing; give it, or a [[block]] for each kind of value"),
        ("[[value]]\nfunction = 3\naddress = 0\ntype = 'int16'", "value: expected one table; a device with several"),
        (f"channels = 2\n{BLOCK}", "channels: with [[block]], each block has its own"),
        (f"plausibility = {{ low = 0, high = 1 }}\n{BLOCK}", "plausibility: with [[block]], each block has its own"),
        (f"{BLOCK}[value]\nfunction = 3\naddress = 1\ntype = 'int16'", "value: omit it where there is a [[block]]"),
        (
            BLOCK.replace("function = 3", "function = 1"),
            "block[0].type: 'int16' is a type of registers, but function 1 reads",
        ),
        (BLOCK.replace("int16", "bit"), "block[0].bit: missing; which bit of the register is the first channel?"),
        (f"{BLOCK}bit = 2", "block[0].bit: 2: only for type 'bit' in registers, function 3 or 4"),
        (f"{BLOCK}addresses = [1, 2]", "block[0].address: 0: omit it, as addresses says it"),
        (BLOCK.replace("address = 0", ""), "block[0].address: missing; give it, or addresses"),
        (BLOCK + BLOCK.replace("int16", "int32") + "stride = 1", "block[1].stride: 1: expected at least 2, the regis"),
        (f"{BLOCK}scaled_by = 'type_code'", 'block[0].type_code: missing; scaled_by = "type_code" needs this table'),
        (f"{BLOCK}unit = 'banana'", "block[0].unit: 'banana' is unknown"),
        (
            f"{BLOCK}[[block.sentinel]]\nraw = 0.5\nquality = 'sensor_fault'\ndetail = 'd'",
            "block[0].sentinel[0].raw: 0.5 cannot occur as int16",
        ),
    ],
)
def test_mistakes_are_named_with_their_place(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(SHORT.format(text), encoding="utf-8")
    with pytest.raises(SetupError) as caught:
        load_profile(str(path))
    assert re.sub(rf"{re.escape(str(path))}(:\d+)?: ", "", str(caught.value)).startswith(message)


def test_each_block_needs_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(SHORT.format(BLOCK).replace('unit = "degC"', ""), encoding="utf-8")
    with refusing(SetupError, "block[0].unit: modbus_no_unit"):
        load_profile(str(path))


def test_channel_number_beyond_the_last_block_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "meter.toml"
    path.write_text(meter_profile(), encoding="utf-8")
    bus = make_bus("b", "modbus_tcp", {"host": "h"})
    with refusing(SetupError, "channel_absent number=11 profile=meter last=10"):
        make_device("d", bus, str(path), 1, {"a": 11}, {}, ManualClock())
