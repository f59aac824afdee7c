"""A user's own profile over the wire: orders, scaling, status, sentinels, limits of the device, plausibility."""

import struct
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from math import inf, isnan, nan
from pathlib import Path

import pytest

from drivers.base import Driver, Quality, Reading, SystemClock
from simulators.devices.modbus_unit import ModbusUnit
from tests.benches.own_profile import by_own_profile

pytestmark = pytest.mark.simulated_time

PROFILE = """
protocol = "modbus"
title = "Somebody's module"
buses = ["modbus_tcp"]
channels = 4
unit = "degC"
max_registers = 6

[value]
function = 3
address = 100
stride = 4
type = "float32"
word_order = "little"
scale = 0.1
offset = -50

[fault_bits]
function = 2
address = 7
quality = "sensor_fault"
detail = "open"

[status]
function = 3
address = 102
stride = 4
mask = 0x00FF
good = [0, 1]
rule = [
    { bit = 7, quality = "out_of_range", detail = "too hot" },
    { equals = 0x42, quality = "sensor_fault", detail = "short" },
]

[[sentinel]]
raw = -9999
quality = "sensor_fault"
detail = "not connected"

[plausibility]
low = -30.0
high = 60.0
"""


class UserProfiledModule:
    """Four channels at registers 100, 104, ...: number in two registers, low word first; status; a register unused."""

    silent = False

    def __init__(self) -> None:
        self.raw = [700.0, 710.0, 720.0, 730.0]
        self.status = [0, 0x3301, 0, 0]
        self.broken = [0, 0, 0, 0]

    def memory(self, function: int) -> Mapping[int, int]:
        if function == 2:
            return {7 + i: bit for i, bit in enumerate(self.broken)}
        words: dict[int, int] = {}
        for i, (raw, status) in enumerate(zip(self.raw, self.status, strict=True)):
            high, low = struct.unpack(">HH", struct.pack(">f", raw))
            words |= {100 + 4 * i: low, 101 + 4 * i: high, 102 + 4 * i: status, 103 + 4 * i: 0xDEAD}
        return words


def reading(
    module: ModbusUnit, folder: Path, channels: Mapping[str, int], profile: str = PROFILE
) -> AbstractAsyncContextManager[Driver]:
    return by_own_profile(module, folder, profile, channels, SystemClock())


def told(readings: Sequence[Reading]) -> list[tuple[str, str]]:
    return [(r.quality.value, r.detail) for r in readings]


async def test_values_in_any_order_of_channels(tmp_path: Path) -> None:
    async with reading(UserProfiledModule(), tmp_path, {"d": 3, "a": 0, "c": 2}) as driver:
        readings = await driver.read()
    assert [(r.channel, r.quality) for r in readings] == [(name, Quality.GOOD) for name in "dac"]
    assert [r.value for r in readings] == pytest.approx([23.0, 20.0, 22.0])


async def test_every_fault_rule(tmp_path: Path) -> None:
    module = UserProfiledModule()
    async with reading(module, tmp_path, {"a": 0, "b": 1, "c": 2, "d": 3}) as driver:
        module.status = [0x80, 0x42, 0x05, 0x01]
        assert told(await driver.read()) == [
            ("out_of_range", "too hot"),
            ("sensor_fault", "short"),
            ("sensor_fault", "status 0x5, which the profile does not define"),
            ("good", ""),
        ]
        module.status, module.broken = [0] * 4, [1, 0, 0, 0]
        module.raw = [-9999.0, -9999.0, 1101.0, nan]
        assert told(await driver.read()) == [
            ("sensor_fault", "open; not connected"),
            ("sensor_fault", "not connected"),
            ("out_of_range", "60.1 degC is outside -30 to 60 degC"),
            ("sensor_fault", "the device sends nan instead of a value"),
        ]
        module.broken, module.raw = [0] * 4, [inf, -inf, 199.0, 700.0]
        qualities = [quality for quality, _ in told(await driver.read())]
        assert qualities == ["sensor_fault", "sensor_fault", "out_of_range", "good"]


async def test_sensor_that_recovers_while_it_is_read_gives_no_value(tmp_path: Path) -> None:
    """Bits are asked for before and after the values if no number of the value itself reports the fault."""

    class Flickering(UserProfiledModule):
        breaks = True

        def memory(self, function: int) -> Mapping[int, int]:
            if function == 3:
                self.raw[0] = 850.0 if self.broken[0] or self.breaks else 700.0
                self.broken[0] = int(self.breaks)
            return super().memory(function)

    module = Flickering()
    profile = PROFILE.replace(PROFILE[PROFILE.index("[[sentinel]]") : PROFILE.index("[plausibility]")], "")
    async with reading(module, tmp_path, {"a": 0, "b": 1}, profile) as driver:
        assert told(await driver.read()) == [("sensor_fault", "open"), ("good", "")]
        module.breaks = False
        assert told(await driver.read()) == [("sensor_fault", "open"), ("good", "")]
        assert [r.value for r in await driver.read()] == pytest.approx([20.0, 21.0])


PACKED = """
protocol = "modbus"
title = "Real numbers, and one register of status bits for all"
buses = ["modbus_tcp"]
channels = 6
unit = "degC"

[value]
function = 3
address = 0
type = "float32"
scale = 1e30

[status]
function = 4
address = 40
channels_per_register = 4
bit_stride = 1
mask = 0x0101
rule = [
    { bit = 0, quality = "sensor_fault", detail = "open" },
    { bit = 8, quality = "out_of_range", detail = "too hot" },
]

[[sentinel]]
raw = -9999.9
quality = "sensor_fault"
detail = "not connected"
"""


class Packed:
    """Six channels, float32 from register 0; bits 0 to 3 of a status register: open, bits 8 to 11: too hot."""

    silent = False

    def __init__(self) -> None:
        self.raw = [20e-30 + i * 1e-30 for i in range(6)]
        self.status = [0, 0]

    def memory(self, function: int) -> Mapping[int, int]:
        if function == 4:
            return {40 + i: word for i, word in enumerate(self.status)}
        return dict(enumerate(struct.unpack(">12H", struct.pack(">6f", *self.raw))))


CHANNELS = {f"c{i}": i for i in range(6)}


async def test_status_bits_of_several_channels_in_one_register(tmp_path: Path) -> None:
    module = Packed()
    async with reading(module, tmp_path, CHANNELS, PACKED) as driver:
        readings = await driver.read()
        assert [r.value for r in readings] == pytest.approx([20.0, 21.0, 22.0, 23.0, 24.0, 25.0])
        module.status = [0b0010_0000_0100, 0b1100_0001_1100_0001]  # bits that belong to no channel do not count
        assert told(await driver.read()) == [
            ("good", ""),
            ("out_of_range", "too hot"),
            ("sensor_fault", "open"),
            ("good", ""),
            ("sensor_fault", "open"),
            ("good", ""),
        ]
        module.status = [0, 0x0002]
        assert told(await driver.read())[4:] == [("good", ""), ("sensor_fault", "open")]
    async with reading(module, tmp_path, {"last": 5}, PACKED) as driver:
        assert told(await driver.read()) == [("sensor_fault", "open")]


async def test_one_status_register_of_all_channels(tmp_path: Path) -> None:
    profile = PROFILE.replace("address = 102\nstride = 4", "address = 102\nstride = 0")
    module = UserProfiledModule()
    async with reading(module, tmp_path, {"a": 0, "d": 3}, profile) as driver:
        module.status = [0, 0x42, 0, 0x42]
        assert told(await driver.read()) == [("good", "")] * 2
        module.status = [0x42, 0, 0, 0]
        assert told(await driver.read()) == [("sensor_fault", "short")] * 2


async def test_sentinel_that_is_not_a_whole_number(tmp_path: Path) -> None:
    """As the device sends it: the nearest number that its four bytes can hold."""
    module = Packed()
    async with reading(module, tmp_path, CHANNELS, PACKED) as driver:
        module.raw[3] = -9999.9
        assert told(await driver.read())[2:4] == [("good", ""), ("sensor_fault", "not connected")]


async def test_value_too_large_to_be_computed_is_not_good(tmp_path: Path) -> None:
    module = Packed()
    async with reading(module, tmp_path, CHANNELS, PACKED.replace("1e30", "1e300")) as driver:
        module.raw[1] = -1e30
        (first, second, *_) = await driver.read()
    assert first.quality is Quality.GOOD
    assert told([second]) == [("sensor_fault", "the reading gives -inf, which is not a finite number")]
    assert isnan(second.value)
