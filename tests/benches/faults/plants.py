"""The plants of the fault matrix, one over each transport; those on CAN are in `can_plants`."""

import tomllib
from collections.abc import Awaitable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from drivers.base import SystemClock
from drivers.build import make_device
from simulators.devices import M7015, Adam6015, MeSensor, RtuLine, TcpHost
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine, Payload
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.profiled_unit import ProfiledUnit
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.source import Faults
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from tests.benches.buses import make_bus
from tests.benches.faults.can_plants import dbc, heartbeat, multicast, slcan, sync, timer
from tests.benches.faults.plant import (
    CHANNELS,
    NEIGHBOUR,
    RANGE_UM,
    SENSORS,
    TIMEOUT_S,
    VICTIM,
    FaultyPlant,
    cable,
    pair,
)
from tests.benches.faults.said import Said, distances, temperatures


class _Served(ModbusUnit, Protocol):
    faults: Faults


async def _rtu(
    folder: Path, profile: str, said: Sequence[Said], victim: _Served, neighbour: _Served, timeout_s: float
) -> FaultyPlant:
    line = RtuLine({VICTIM: victim, NEIGHBOUR: neighbour})
    plug, unplug = cable(folder / "rtu", line.start, line.stop)
    await plug()
    bus = make_bus("rtu", "modbus_rtu", {"port": str(folder / "rtu"), "baud": 115200, "timeout_s": timeout_s})
    drivers = pair(bus, (profile, profile), {})
    return FaultyPlant(bus, drivers, said, victim.faults, unplug, plug, wire=line, stop=[line.stop])


async def rtu(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Modbus RTU on a pseudo-terminal."""
    said = temperatures(6)
    victim, neighbour = map(M7015, said)
    plant = await _rtu(folder, "icpdas_m7015", said, victim, neighbour, timeout_s)
    plant.retype = lambda code: victim.set_type_code(0, code or 0x2E)
    plant.last_word = False  # values, then bits
    return plant


async def pta(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Modbus RTU with modules that do not notice broken sensors."""
    said = temperatures(8)
    victim, neighbour = map(Pta8d08, said)
    return await _rtu(folder, "eletechsup_pta8d08", said, victim, neighbour, timeout_s)


async def analogue(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Analogue displacement sensors on voltage input modules."""
    said = distances(8)
    victim, neighbour = (VoltageInput(source, range_um=RANGE_UM) for source in said)
    return await _rtu(folder, "analogue_displacement", said, victim, neighbour, timeout_s)


BLOCKS = """
protocol = "modbus"
title = "Two kinds of values: float32 with a status register, and int16"
buses = ["modbus_rtu"]
unit = "degC"
[[block]]
function = 4
address = 20
type = "float32"
word_order = "little"
[block.status]
function = 4
address = 22
rule = [
    { equals = 1, quality = "sensor_fault", detail = "sensor is broken" },
    { equals = 2, quality = "out_of_range", detail = "beyond the range" },
]
[[block]]
function = 3
address = 7
type = "int16"
scale = 0.01
"""


async def blocks(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Modbus RTU with units that have a block of float32 and one of int16, read by two functions."""
    said = temperatures(2)
    path = folder / "blocks.toml"
    path.write_text(BLOCKS, encoding="utf-8")
    victim, neighbour = (ProfiledUnit(tomllib.loads(BLOCKS), source) for source in said)
    plant = await _rtu(folder, str(path), said, victim, neighbour, timeout_s)
    plant.last_word = False  # one block, then the other
    return plant


async def _tcp(
    profile: str, said: Sequence[Said], victim: _Served, neighbour: _Served, timeout_s: float
) -> FaultyPlant:
    host = TcpHost({VICTIM: victim, NEIGHBOUR: neighbour})
    port = await host.start()

    async def plug() -> None:
        await host.start(port)

    bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": timeout_s})
    drivers = pair(bus, (profile, profile), {})
    return FaultyPlant(
        bus, drivers, said, victim.faults, host.stop, plug, wire=host, server=host.server, stop=[host.stop]
    )


async def tcp(_: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Modbus TCP on loopback, two units behind one host."""
    said = temperatures(7)
    victim, neighbour = map(Adam6015, said)
    plant = await _tcp("advantech_adam6015", said, victim, neighbour, timeout_s)
    plant.retype = lambda code: victim.set_type_code(0, code or 0x03A4)
    return plant


async def wago(_: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Modules behind couplers: only the status byte reports a fault."""
    said = temperatures(4)
    victim, neighbour = map(Wago464, said)
    return await _tcp("wago_750_464", said, victim, neighbour, timeout_s)


async def other() -> FaultyPlant:
    """A separate healthy bus."""
    said, _ = temperatures(7)
    device = Adam6015(said)
    host = TcpHost({1: device})
    bus = make_bus("other", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    driver = make_device("other", bus, "advantech_adam6015", 1, {"other": 0}, {}, SystemClock())
    return FaultyPlant(bus, (driver,), [said], device.faults, host.stop, host.stop, stop=[host.stop])


async def _sensors(folder: Path, profile: str, payload: Payload, timeout_s: float) -> FaultyPlant:
    """Two displacement sensors on one line."""
    said = distances(1)
    victim, neighbour = (
        MeSensor(source, range_um=RANGE_UM, address=address, payload=payload)
        for source, address in zip(said, SENSORS, strict=True)
    )
    line = MeLine([victim, neighbour])
    plug, unplug = cable(folder / "me", line.start, line.stop)
    await plug()
    bus = make_bus("me", "me_rs485", {"port": str(folder / "me"), "timeout_s": timeout_s})
    drivers = tuple(
        make_device(name, bus, profile, address, {name: 0}, {"range_um": RANGE_UM}, SystemClock())
        for name, address in zip(("victim", "neighbour"), SENSORS, strict=True)
    )
    return FaultyPlant(bus, drivers, said, victim.faults, unplug, plug, wire=line, stop=[line.stop])


async def me_rs485(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Displacement sensors on a pseudo-terminal."""
    return await _sensors(folder, "me_rs485", "float", timeout_s)


async def dt6120(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """The same, with the other form of data."""
    return await _sensors(folder, "me_dt6120", "counted", timeout_s)


async def me_ethernet(_folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """One displacement controller on loopback."""
    said, _ = distances(2)
    controller = MeController(said, range_um=RANGE_UM)
    port = await controller.start()

    async def plug() -> None:
        await controller.start(port)

    bus = make_bus("eddy", "me_ethernet", {"host": "127.0.0.1", "port": port, "timeout_s": 2 * timeout_s})
    driver = make_device("victim", bus, "me_ethernet", 1, CHANNELS, {"range_um": RANGE_UM}, SystemClock())
    plant = FaultyPlant(bus, (driver,), [said], controller.faults, controller.stop, plug, wire=controller)
    plant.server, plant.stop, plant.last_word = controller.server, [controller.stop], False
    return plant


class Make(Protocol):
    """A plant on a new wire, its devices' names in an empty folder."""

    def __call__(self, folder: Path, /, timeout_s: float = TIMEOUT_S) -> Awaitable[FaultyPlant]: ...


PLANTS: Mapping[str, Make] = {
    "rtu": rtu,
    "pta": pta,
    "analogue": analogue,
    "blocks": blocks,
    "tcp": tcp,
    "wago": wago,
    "slcan": slcan,
    "heartbeat": heartbeat,
    "sync": sync,
    "timer": timer,
    "multicast": multicast,
    "dbc": dbc,
    "me_rs485": me_rs485,
    "dt6120": dt6120,
    "me_ethernet": me_ethernet,
}
MODBUS_LINE = ("rtu", "pta", "analogue", "blocks")
CANOPEN = ("slcan", "sync", "timer")
CAN = (*CANOPEN, "dbc")
ME_LINE = ("me_rs485", "dt6120")
