"""A rounding error about 0 is read as 0 from every kind of device: 27315 * 0.01 - 273.15 is not 5.7e-14 degC."""

import re
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from importlib.resources import files
from pathlib import Path

import pytest

from drivers.base import Bus, Driver, SystemClock
from drivers.build import make_device
from drivers.can.dbc_profile import CanDbcProfile
from drivers.profile import LinearValue
from drivers.profiles import load_profile
from simulators.devices import Cia404Node, MeSensor, SlcanAdapter, TcpHost
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

RAW, SCALE, OFFSET, HIGH = 27315, 0.01, -273.15, 382.2
"""A temperature in hundredths of a kelvin, at 0 degC; what 65535 means."""
COUNTS = 4080
"""Counts of the emulated CANopen converter, which sends 4000 at 0 degC and 20 more for each degree."""
RANGE_UM, ZERO_UM = 3.0, 0.6
"""Range and zero of a displacement sensor that measures a fifth of its range."""

HEAD = """
title = "hundredths of a kelvin"
unit = "degC"
"""
LINEAR = f'protocol = "modbus"\nbuses = ["modbus_tcp"]\nchannels = 1\n{HEAD}[value]\nfunction = 3\naddress = 0\n'
BY_SCALE = f'{LINEAR}type = "uint16"\nscale = {SCALE}\noffset = {OFFSET}\n'
BY_CODE = f"""{LINEAR}type = "uint16"
scaled_by = "type_code"
[type_code]
function = 3
address = 1
raw_high = 65535
code = [{{ code = 7, low = {OFFSET}, high = {HIGH} }}]
"""
DBC = 'BU_: L\nBO_ 768 M: 8 L\n SG_ T : 0|16@1+ (0.01,-273.15) [-273.15|382.2] "degC" L\n'


def test_without_care_each_of_them_would_not_be_zero() -> None:
    assert RAW * SCALE + OFFSET != 0.0
    assert OFFSET + RAW * (HIGH - OFFSET) / 65535 != 0.0
    assert COUNTS * SCALE - COUNTS / 100 != 0.0
    assert 0.2 * RANGE_UM - ZERO_UM != 0.0


class KelvinRegisters:
    """Two registers: the value, and the type code."""

    silent = False

    def memory(self, function: int) -> Mapping[int, int]:
        return {0: RAW, 1: 7} if function == 3 else {}


async def modbus(stack: AsyncExitStack, folder: Path, profile: str) -> tuple[Bus, Driver]:
    path = folder / "kelvin.toml"
    path.write_text(profile, encoding="utf-8")
    host = TcpHost({1: KelvinRegisters()})
    stack.push_async_callback(host.stop)
    bus = make_bus("b", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    return bus, make_device("d", bus, str(path), 1, {"c": 0}, {}, SystemClock())


async def modbus_by_scale(stack: AsyncExitStack, folder: Path) -> tuple[Bus, Driver]:
    return await modbus(stack, folder, BY_SCALE)


async def modbus_by_code(stack: AsyncExitStack, folder: Path) -> tuple[Bus, Driver]:
    return await modbus(stack, folder, BY_CODE)


async def field_value(stack: AsyncExitStack, folder: Path) -> tuple[Bus, Driver]:
    text = (files("drivers") / "profiles" / "cia404.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[physical_unit\]\n.*\n", "", text)
    path = folder / "field.toml"
    counts = f'object = "7100"\nscale = {SCALE}\noffset = {-COUNTS / 100}'
    path.write_text(text.replace('object = "9130"', counts), encoding="utf-8")
    node = Cia404Node(5, lambda: [(COUNTS - 4000) / 20], inputs=1, mapped=0x7100)
    adapter = SlcanAdapter([node])
    bus = make_bus("b", "canopen", {"interface": "slcan", "channel": await adapter.start()})
    stack.push_async_callback(adapter.stop)
    return bus, make_device("d", bus, str(path), 5, {"c": 0}, {"vendor": "jumo"}, SystemClock())


async def controller(stack: AsyncExitStack, _: Path) -> tuple[Bus, Driver]:
    device = MeController(lambda: [RANGE_UM / 5], range_um=RANGE_UM)
    stack.push_async_callback(device.stop)
    bus = make_bus("b", "me_ethernet", {"host": "127.0.0.1", "port": await device.start()})
    options = {"range_um": RANGE_UM, "zero_um": ZERO_UM}
    return bus, make_device("d", bus, "me_ethernet", 1, {"c": 0}, options, SystemClock())


async def sensor(stack: AsyncExitStack, _: Path) -> tuple[Bus, Driver]:
    """A sensor at a fifth of a range whose end is 0xF00000."""
    line = MeLine([MeSensor(lambda: [RANGE_UM / 5], range_um=RANGE_UM, payload="counted")])
    stack.push_async_callback(line.stop)
    bus = make_bus("b", "me_rs485", {"port": await line.start()})
    options = {"range_um": RANGE_UM, "zero_um": ZERO_UM}
    return bus, make_device("d", bus, "me_dt6120", 0x7E, {"c": 0}, options, SystemClock())


StartAtZero = Callable[[AsyncExitStack, Path], Awaitable[tuple[Bus, Driver]]]


@asynccontextmanager
async def connected(start: StartAtZero, folder: Path) -> AsyncIterator[Driver]:
    async with AsyncExitStack() as stack:
        bus, driver = await start(stack, folder)
        stack.push_async_callback(bus.close)
        await bus.connect()
        await driver.connect()
        yield driver


@pytest.mark.parametrize("start", [modbus_by_scale, modbus_by_code, field_value, controller, sensor])
async def test_zero_is_read_as_zero(start: StartAtZero, tmp_path: Path) -> None:
    async with connected(start, tmp_path) as driver:
        (reading,) = await driver.read()
    assert reading.value == 0.0, reading


def test_zero_of_a_dbc_file(tmp_path: Path) -> None:
    (tmp_path / "kelvin.dbc").write_text(DBC, encoding="ascii")
    path = tmp_path / "kelvin.toml"
    path.write_text(
        f'protocol = "can_dbc"\n{HEAD}dbc = "kelvin.dbc"\n[[signal]]\nmessage = "M"\nname = "T"\n', encoding="utf-8"
    )
    profile = load_profile(str(path))
    assert isinstance(profile, CanDbcProfile)
    assert profile.signals[0].decode(struct.pack("<H6x", RAW)) == 0.0
    assert profile.signals[0].decode(struct.pack("<H6x", RAW + 1)) == pytest.approx(0.01)


def test_zero_of_nodes_objects_topics_and_pins() -> None:
    """All of them are a `LinearValue`."""
    assert LinearValue(scale=SCALE, offset=OFFSET).value(RAW) == 0.0
