"""One dead device out of three on a bus: the other two keep their period within 20 %, with the default settings.

The gateway makes the buses from a configuration that states only what it must. The dead one may be any of
the three, and may fall silent or be dead from the start. Then the first readings of all others come `timeout_s` later,
as nobody knows yet how long a device takes.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from simulators.devices import M7015, Adam6015, Cia404Node, SlcanAdapter
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.source import Faults
from tests.benches.polled_three import MODBUS, PERIOD_S, TIMEOUT_S, UNITS, polled, started_line, worst

pytestmark = pytest.mark.simulated_time

PERIODS, MOST = 20, 0.2


@dataclass
class ThreeDevices:
    """Three emulated devices, and the fields by which a configuration finds them."""

    fields: Mapping[str, object]
    profile: str
    options: str
    faults: Mapping[int, Faults]


StartThree = Callable[[AsyncExitStack], Awaitable[ThreeDevices]]


async def modbus(kind: str, stack: AsyncExitStack) -> ThreeDevices:
    units: dict[int, M7015 | Adam6015]
    if kind == "modbus_tcp":
        units, profile = {unit: Adam6015(lambda: [21.0] * 7) for unit in UNITS}, "advantech_adam6015"
    else:
        units, profile = {unit: M7015(lambda: [21.0] * 6) for unit in UNITS}, "icpdas_m7015"
    _, fields = await started_line(kind, units, stack)
    return ThreeDevices(fields, profile, "", {unit: it.faults for unit, it in units.items()})


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


WIRES: dict[str, StartThree] = {**{kind: partial(modbus, kind) for kind in MODBUS}, "canopen": canopen}


def polling(wire: ThreeDevices, folder: Path, readings: list[Reading]) -> AbstractAsyncContextManager[None]:
    device = f'profile = "{wire.profile}"\n{wire.options}'
    return polled(wire.fields, device, "{ cUNIT = 0 }", folder, readings)


def worst_of_others(readings: list[Reading], dead: int) -> dict[int, float]:
    """The worst difference from the period of the other devices, by unit."""
    others = [unit for unit in UNITS if unit != dead]
    assert all(sum(r.channel == f"c{unit}" for r in readings) >= PERIODS - 1 for unit in others)
    return {unit: worst(readings, f"c{unit}") for unit in others}


@pytest.mark.parametrize(("kind", "dead"), [*zip(WIRES, cycle(UNITS), strict=False)])
async def test_one_of_three_falls_silent(kind: str, dead: int, tmp_path: Path) -> None:
    readings: list[Reading] = []
    async with AsyncExitStack() as stack:
        wire = await WIRES[kind](stack)
        async with polling(wire, tmp_path, readings):
            await asyncio.sleep(9.5 * PERIOD_S)
            wire.faults[dead].silent = True
            await asyncio.sleep(PERIODS * PERIOD_S)
    others = worst_of_others(readings, dead)
    print(kind, dead, "fell silent", others)
    assert max(others.values()) <= MOST
    assert [r.quality for r in readings if r.channel == f"c{dead}"][-PERIODS + 1 :] == [Quality.COMM_FAULT] * (
        PERIODS - 1
    )


@pytest.mark.parametrize(("kind", "dead"), [*zip(WIRES, cycle(UNITS[::-1]), strict=False)])
async def test_one_of_three_is_dead_from_the_start(kind: str, dead: int, tmp_path: Path) -> None:
    readings: list[Reading] = []
    async with AsyncExitStack() as stack:
        wire = await WIRES[kind](stack)
        wire.faults[dead].silent = True
        began_s = time.monotonic()
        async with polling(wire, tmp_path, readings):
            await asyncio.sleep(PERIODS * PERIOD_S)
    others = worst_of_others(readings, dead)
    firsts = {unit: next(r for r in readings if r.channel == f"c{unit}").monotonic_s - began_s for unit in others}
    print(kind, dead, "dead from the start", others, "first readings after", firsts)
    assert max(others.values()) <= MOST
    assert max(firsts.values()) <= TIMEOUT_S + 0.1


async def test_units_that_are_slow_but_in_time_are_read_from_the_first_period_on(tmp_path: Path) -> None:
    """This is why an unknown device is given its full time: a shorter one would cost a slow one its readings."""
    readings: list[Reading] = []
    units = {unit: Pta8d08(lambda: [21.0] * 8) for unit in UNITS}
    async with AsyncExitStack() as stack:
        line, fields = await started_line("modbus_rtu", units, stack)
        line.spoil = lambda _unit, frame: ((0.25, frame),)
        async with polling(ThreeDevices(fields, "eletechsup_pta8d08", "", {}), tmp_path, readings):
            await asyncio.sleep(PERIODS * PERIOD_S)
    assert {r.quality for r in readings} == {Quality.GOOD}
    assert len(readings) >= len(UNITS) * (PERIODS - 1)
