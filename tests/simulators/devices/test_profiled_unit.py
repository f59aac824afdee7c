"""Units emulated from a profile: read by the driver with that profile, and compared with the emulators of real
devices."""

import asyncio
import tomllib
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

import pytest

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.rtu import ModbusRtuBus
from simulators.devices.__main__ import device_of
from simulators.devices.adam6015 import Adam6015
from simulators.devices.m7015 import M7015
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.profiled_unit import ProfiledUnit
from simulators.devices.scenario import Scenario
from simulators.devices.source import SensorFault, ValueSource
from simulators.devices.wago464 import Wago464
from tests.benches.emulated_profiles import emulated

EVERYTHING = """
protocol = "modbus"
title = "Every way to hold a number and to report a fault"
buses = ["{bus}"]
unit = "1"
[[block]]                   # 0 and 1
function = 4
address = 10
channels = 2
type = "float64"
word_order = "little"
[block.fault_bits]
function = 1
address = 5
quality = "sensor_fault"
detail = "bit"
[[block]]                   # 2 and 3
function = 3
addresses = [40, 7]
type = "int32"
byte_order = "little"
scale = 0.01
offset = -50
unit = "degC"
[[block.sentinel]]
raw = 99999
quality = "sensor_fault"
detail = "open"
[block.plausibility]
low = -20.0
high = 95.0
[[block]]                   # 4 to 6
function = 3
address = 100
channels = 3
type = "uint16"
[block.status]
function = 4
address = 60
channels_per_register = 2
bit_stride = 4
mask = 0x000F
rule = [
    {{ bit = 2, quality = "sensor_fault", detail = "status" }},
    {{ equals = 9, quality = "out_of_range", detail = "r" }},
]
[[block]]                   # 7 to 9: bits 14 and 15, and bit 0 of the next register
function = 4
address = 80
channels = 3
bit = 14
type = "bit"
byte_order = "little"
[[block]]                   # 10 and 11: one inverted
function = 2
address = 3
channels = 2
type = "bit"
scale = -1.0
offset = 1.0
[[block]]                   # 12
function = 3
address = 200
type = "uint16"
scaled_by = "type_code"
unit = "degC"
[block.type_code]
function = 3
address = 210
raw_low = 0
raw_high = 65535
code = [{{ code = 5, low = -50, high = 150 }}]
[[block]]                   # 13 and 14
function = 3
address = 300
channels = 2
type = "int16"
shift = 2
scale = 0.1
[[block.sentinel]]
raw = 8188
quality = "sensor_fault"
detail = "no data"
"""
VALUES = [1.5, -2e300, 21.37, -19.99, 7.0, 65535.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 36.6, -3.3, 819.1]


@pytest.mark.simulated_time
@pytest.mark.parametrize("kind", ["modbus_rtu", "modbus_tcp"])
async def test_it_is_read_by_the_same_profile(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "all.toml"
    path.write_text(EVERYTHING.format(bus=kind), encoding="utf-8")
    scenario = Scenario.parse(
        f"[[at]]\ns = 0\nvalues = {VALUES}\n"
        + "".join(f'[[at]]\ns = 5\nfault = "open"\nchannel = {number}\n' for number in (0, 2, 5, 14))
        + "".join(f'[[at]]\ns = 5\nfault = "over"\nchannel = {number}\n' for number in (3, 6))
    )
    async with emulated(str(path), scenario) as bus:
        assert isinstance(bus, ModbusTcpBus if kind == "modbus_tcp" else ModbusRtuBus)
        driver = make_device("device", bus, str(path), 1, {f"c{i}": i for i in range(15)}, {}, SystemClock())
        await bus.connect()
        await driver.connect()
        before = await driver.read()
        await asyncio.sleep(6.0)
        after = await driver.read()
    assert {reading.quality for reading in before} == {Quality.GOOD}
    assert [reading.value for reading in before] == pytest.approx(VALUES, rel=1e-6, abs=2e-3)
    assert told(after) == {
        "c0": "bit",
        "c2": "open",
        "c3": "190 degC is outside -20 to 95 degC",
        "c5": "status",
        "c6": "r",
        "c14": "no data",
    }


def told(readings: Sequence[Reading]) -> dict[str, str]:
    return {reading.channel: reading.detail for reading in readings if reading.quality is not Quality.GOOD}


@pytest.mark.parametrize(
    ("name", "device", "values"),
    [
        ("icpdas_m7015", M7015, [20.0, 21.3, -3.3, 40.0, 99.9, 22.2]),
        ("advantech_adam6015", Adam6015, [20.0, 21.3, -3.3, 40.0, 99.9, 22.2, 23.4]),
        ("wago_750_464", Wago464, [20.0, 21.3, -3.3, 40.0]),
    ],
)
def test_it_holds_what_the_real_device_holds(
    name: str, device: Callable[[ValueSource], ModbusUnit], values: list[float]
) -> None:
    """The emulators of these devices were written from their manuals, the profile's unit only from the profile."""
    text = (files("drivers") / "profiles" / f"{name}.toml").read_text(encoding="utf-8")
    unit, real = ProfiledUnit(tomllib.loads(text), lambda: values), device(lambda: values)
    for function in (1, 2, 3, 4):
        mine, theirs = unit.memory(function), real.memory(function)
        assert set(mine) == set(theirs)
        if function != 3 or name == "wago_750_464":  # the first code of the profile is not that of the emulator
            assert mine == theirs


def test_file_that_is_no_modbus_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "node.toml"
    path.write_text('protocol = "cia404"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"node\.toml: not a Modbus profile: 'block' is missing"):
        device_of(str(path))
    with pytest.raises(ValueError, match="'m7016' is unknown: expected a path of a Modbus profile, or one of m7015, "):
        device_of("m7016")


def test_what_it_refuses_is_absent() -> None:
    unit = ProfiledUnit(tomllib.loads(EVERYTHING.format(bus="modbus_tcp")), lambda: VALUES)
    unit.refused.add((3, 101))
    assert sorted(address for address in unit.memory(3) if 100 <= address < 110) == [100, 102]
    unit.faults.set(4, SensorFault.OPEN)
    assert unit.memory(4)[60] == 0b0100
