"""One dead device out of three on a bus: the two others keep their period within 20 %, with the default settings.

The lines are those that the gateway makes of a configuration that states only what it must. The dead one may be any of
the three, and may fall silent or be dead from the start. Then the first readings of all others come `timeout_s` later,
as nobody knows yet how long a device takes.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality, Reading
from gateway.acquisition import Acquisition, lines_of
from gateway.clock import RealClock
from gateway.config import load
from simulators.devices import M7015, Adam6015, Cia404Node, DeviceServer, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.source import Faults

pytestmark = pytest.mark.simulated_time

UNITS = (1, 2, 3)
PERIOD_S, TIMEOUT_S, PERIODS, MOST = 1.0, 0.5, 20, 0.2
BAUD = 9600
"""The default of a serial line; its emulator takes the time that its bytes take."""


@dataclass
class ThreeDevices:
    """Three emulated devices, and the fields by which a configuration finds them."""

    fields: Mapping[str, object]
    profile: str
    options: str
    faults: Mapping[int, Faults]


StartThree = Callable[[AsyncExitStack], Awaitable[ThreeDevices]]


async def rtu(stack: AsyncExitStack) -> ThreeDevices:
    units = {unit: M7015(lambda: [21.0] * 6) for unit in UNITS}
    line = RtuLine(units, baud=BAUD)
    stack.push_async_callback(line.stop)
    fields = {"kind": "modbus_rtu", "port": await line.start()}
    return ThreeDevices(fields, "icpdas_m7015", "", {unit: it.faults for unit, it in units.items()})


async def rtu_tcp(stack: AsyncExitStack) -> ThreeDevices:
    units = {unit: M7015(lambda: [21.0] * 6) for unit in UNITS}
    server = DeviceServer(units)
    stack.push_async_callback(server.stop)
    fields = {"kind": "modbus_rtu_tcp", "host": "127.0.0.1", "port": await server.start()}
    return ThreeDevices(fields, "icpdas_m7015", "", {unit: it.faults for unit, it in units.items()})


async def tcp(stack: AsyncExitStack) -> ThreeDevices:
    units = {unit: Adam6015(lambda: [21.0] * 7) for unit in UNITS}
    host = TcpHost(units)
    stack.push_async_callback(host.stop)
    fields = {"kind": "modbus_tcp", "host": "127.0.0.1", "port": await host.start()}
    return ThreeDevices(fields, "advantech_adam6015", "", {unit: it.faults for unit, it in units.items()})


async def canopen(stack: AsyncExitStack) -> ThreeDevices:
    nodes = {unit: Cia404Node(unit, lambda: [21.0] * 4, inputs=4) for unit in UNITS}
    adapter = SlcanAdapter(list(nodes.values()))
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    for node in nodes.values():
        node.start(adapter.send)
        stack.callback(node.stop)
    fields = {"kind": "canopen", "interface": "slcan", "channel": path}
    return ThreeDevices(
        fields, "cia404", 'options = { vendor = "jumo" }', {unit: node.faults for unit, node in nodes.items()}
    )


WIRES: dict[str, StartThree] = {"modbus_rtu": rtu, "modbus_rtu_tcp": rtu_tcp, "modbus_tcp": tcp, "canopen": canopen}


@asynccontextmanager
async def polled(wire: ThreeDevices, folder: Path, readings: list[Reading]) -> AsyncIterator[None]:
    """Inside, the gateway polls the three."""
    bus = "\n".join(f"{key} = {value!r}" for key, value in wire.fields.items())
    devices = "".join(
        f'[[device]]\nname = "d{unit}"\nbus = "wire"\nprofile = "{wire.profile}"\nunit = {unit}\n{wire.options}\n'
        f"channels = {{ c{unit} = 0 }}\n"
        for unit in UNITS
    )
    file = folder / "gateway.toml"
    file.write_text(f'[machine]\nname = "mill"\n[[bus]]\nname = "wire"\n{bus}\n{devices}')
    clock = RealClock()
    (line,) = lines_of(load(file), clock)
    assert (line.period_s, line.bus.timeout_s) == (PERIOD_S, TIMEOUT_S), "the defaults"
    async with Acquisition([line], clock, readings.extend, lambda _: None):
        yield


def worst(readings: list[Reading], unit: int, since_s: float = 0.0) -> float:
    """By how much the unit's intervals differ from the period at most, as a share; its readings are good."""
    own = [r for r in readings if r.channel == f"c{unit}" and r.monotonic_s >= since_s]
    assert {r.quality for r in own} == {Quality.GOOD}
    assert len(own) >= PERIODS - 1
    return float(np.abs(np.diff([r.monotonic_s for r in own]) / PERIOD_S - 1.0).max())


@pytest.mark.parametrize("dead", UNITS)
@pytest.mark.parametrize("kind", WIRES)
async def test_one_of_three_falls_silent(kind: str, dead: int, tmp_path: Path) -> None:
    readings: list[Reading] = []
    async with AsyncExitStack() as stack:
        wire = await WIRES[kind](stack)
        async with polled(wire, tmp_path, readings):
            await asyncio.sleep(9.5 * PERIOD_S)
            wire.faults[dead].silent = True
            await asyncio.sleep(PERIODS * PERIOD_S)
    others = {unit: worst(readings, unit) for unit in UNITS if unit != dead}
    print(kind, dead, "fell silent", others)
    assert max(others.values()) <= MOST
    assert [r.quality for r in readings if r.channel == f"c{dead}"][-PERIODS + 1 :] == [Quality.COMM_FAULT] * (
        PERIODS - 1
    )


@pytest.mark.parametrize("dead", UNITS)
@pytest.mark.parametrize("kind", WIRES)
async def test_one_of_three_is_dead_from_the_start(kind: str, dead: int, tmp_path: Path) -> None:
    readings: list[Reading] = []
    async with AsyncExitStack() as stack:
        wire = await WIRES[kind](stack)
        wire.faults[dead].silent = True
        began_s = time.monotonic()
        async with polled(wire, tmp_path, readings):
            await asyncio.sleep(PERIODS * PERIOD_S)
    others = {unit: worst(readings, unit) for unit in UNITS if unit != dead}
    firsts = {unit: next(r for r in readings if r.channel == f"c{unit}").monotonic_s - began_s for unit in others}
    print(kind, dead, "dead from the start", others, "first readings after", firsts)
    assert max(others.values()) <= MOST
    assert max(firsts.values()) <= TIMEOUT_S + 0.1


async def test_units_that_are_slow_but_in_time_are_read_from_the_first_period_on(tmp_path: Path) -> None:
    """This is why an unknown device is given its full time: a shorter one would cost a slow one its readings."""
    readings: list[Reading] = []
    units = {unit: Pta8d08(lambda: [21.0] * 8) for unit in UNITS}
    line = RtuLine(units, baud=BAUD)
    fields = {"kind": "modbus_rtu", "port": await line.start()}
    line.spoil = lambda _unit, frame: ((0.25, frame),)
    try:
        async with polled(ThreeDevices(fields, "eletechsup_pta8d08", "", {}), tmp_path, readings):
            await asyncio.sleep(PERIODS * PERIOD_S)
    finally:
        await line.stop()
    assert {r.quality for r in readings} == {Quality.GOOD}
    assert len(readings) >= len(UNITS) * (PERIODS - 1)
