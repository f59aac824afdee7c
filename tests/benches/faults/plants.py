"""Small plants for the fault matrix: one wire with a victim and a neighbour, over each transport."""

import tomllib
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drivers.base import Bus, Driver, SystemClock
from drivers.build import make_bus, make_device
from simulators.devices import M7015, Adam6015, Cia404Node, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.can_logger import CanLogger
from simulators.devices.loopback import LoopbackServer
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine, Payload
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.multicast_bus import MulticastBus
from simulators.devices.profiled_unit import ProfiledUnit
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import Faults
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from tests.benches.faults.said import Said, distances, temperatures
from tests.benches.free_port import free_port
from tests.benches.logger_files import logger_profile
from tests.benches.rigs import Spoilable

TIMEOUT_S = 0.045
HEARTBEAT_MS, EVENT_MS = 80, 25
VICTIM, NEIGHBOUR = 1, 2
SENSORS = (0x7E, 0x7D)
RANGE_UM = 500.0
CHANNELS = {"victim": 0, "beside": 1}
"""Channel 0 of the victim is broken; channel 1 sits on the same device."""

FaultStep = Callable[[], Awaitable[None]]


@dataclass
class FaultyPlant:
    """One bus under test, its two devices, and what the test may do to them."""

    bus: Bus
    drivers: tuple[Driver, ...]
    said: Sequence[Said]
    """What each device measures."""
    faults: Faults
    unplug: FaultStep
    plug: FaultStep
    wire: Spoilable | None = None
    adapter: SlcanAdapter | None = None
    node: Cia404Node | None = None
    server: LoopbackServer | None = None
    send: Callable[[list[CanFrame]], None] = lambda _: None
    """Frames that another node on a CAN bus sends."""
    retype: Callable[[int], None] = lambda _: None
    """Another type code at the victim's channel 0; 0 is the right one again."""
    stop: Sequence[FaultStep] = ()
    last_word: bool = True
    """A reading comes of one request: it shows what the device said last, not just what it said since the last one."""


def _pair(bus: Bus, profiles: tuple[str, str], options: Mapping[str, object]) -> tuple[Driver, Driver]:
    clock = SystemClock()
    return (
        make_device("victim", bus, profiles[0], VICTIM, CHANNELS, options, clock),
        make_device("neighbour", bus, profiles[1], NEIGHBOUR, {"neighbour": 0}, options, clock),
    )


def _point(link: Path, path: str | None) -> None:
    """What udev does: the name is there while the adapter is."""
    link.unlink(missing_ok=True)
    if path is not None:
        link.symlink_to(path)


def _cable(link: Path, start: Callable[[], Awaitable[str]], stop: FaultStep) -> tuple[FaultStep, FaultStep]:
    """Plug and unplug: a new terminal each time, under the same name."""

    async def plug() -> None:
        _point(link, await start())

    async def unplug() -> None:
        _point(link, None)
        await stop()

    return plug, unplug


class _Served(ModbusUnit, Protocol):
    faults: Faults


async def _rtu(
    folder: Path, profile: str, said: Sequence[Said], victim: _Served, neighbour: _Served, timeout_s: float
) -> FaultyPlant:
    line = RtuLine({VICTIM: victim, NEIGHBOUR: neighbour})
    plug, unplug = _cable(folder / "rtu", line.start, line.stop)
    await plug()
    bus = make_bus("rtu", "modbus_rtu", {"port": str(folder / "rtu"), "baud": 115200, "timeout_s": timeout_s})
    drivers = _pair(bus, (profile, profile), {})
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
    drivers = _pair(bus, (profile, profile), {})
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
    """Modules behind couplers: only the status byte tells."""
    said = temperatures(4)
    victim, neighbour = map(Wago464, said)
    return await _tcp("wago_750_464", said, victim, neighbour, timeout_s)


async def other() -> FaultyPlant:
    """A healthy bus of its own."""
    said, _ = temperatures(7)
    device = Adam6015(said)
    host = TcpHost({1: device})
    bus = make_bus("other", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    driver = make_device("other", bus, "advantech_adam6015", 1, {"other": 0}, {}, SystemClock())
    return FaultyPlant(bus, (driver,), [said], device.faults, host.stop, host.stop, stop=[host.stop])


def _nodes(said: tuple[Said, Said], heartbeat_ms: int = 0, event_ms: int = 0) -> tuple[Cia404Node, Cia404Node]:
    def node(number: int, source: Said) -> Cia404Node:
        return Cia404Node(number, source, inputs=2, heartbeat_ms=heartbeat_ms, event_ms=event_ms)

    return node(VICTIM, said[0]), node(NEIGHBOUR, said[1])


def _canopen(
    bus: Bus, said: Sequence[Said], node: Cia404Node, transfer: str, plug: FaultStep, unplug: FaultStep
) -> FaultyPlant:
    drivers = _pair(bus, ("cia404", "cia404"), {"vendor": "jumo", "transfer": transfer})
    plant = FaultyPlant(bus, drivers, said, node.faults, unplug, plug, node=node, last_word=False)
    plant.retype = lambda code: node.set_sensor_type(0, code or 30)
    return plant


async def _slcan(
    folder: Path, transfer: str, timeout_s: float = TIMEOUT_S, heartbeat_ms: int = 0, event_ms: int = 0
) -> FaultyPlant:
    said = temperatures(2, high=800.0)  # a node is asked for its source often
    nodes = _nodes(said, heartbeat_ms, event_ms)
    adapter = SlcanAdapter(nodes)
    for node in nodes:
        node.start(adapter.send)
    plug, unplug = _cable(folder / "can", adapter.start, adapter.stop)
    await plug()

    async def stop() -> None:
        for node in nodes:
            node.stop()
        await adapter.stop()

    options = {"interface": "slcan", "channel": str(folder / "can"), "timeout_s": timeout_s}
    plant = _canopen(make_bus("can", "canopen", options), said, nodes[0], transfer, plug, unplug)
    plant.adapter = plant.wire = adapter
    plant.send, plant.stop = adapter.send, [stop]
    return plant


async def slcan(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """CANopen by SDO through a serial CAN adapter."""
    return await _slcan(folder, "sdo", timeout_s)


async def heartbeat(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """The same, heartbeats watched."""
    return await _slcan(folder, "sdo", timeout_s, heartbeat_ms=HEARTBEAT_MS)


async def sync(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """CANopen by TPDOs after SYNC, heartbeats watched."""
    return await _slcan(folder, "sync", timeout_s, heartbeat_ms=HEARTBEAT_MS)


async def timer(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """CANopen by TPDOs that the nodes send by their timers, heartbeats watched."""
    return await _slcan(folder, "timer", timeout_s, heartbeat_ms=HEARTBEAT_MS, event_ms=EVENT_MS)


async def multicast(_: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """CANopen over UDP multicast, as between two programs."""
    port, said, group = free_port(), temperatures(2, high=800.0), "239.74.163.4"
    nodes = _nodes(said)
    wire = MulticastBus(nodes, group, port)
    wire.start()

    async def plug() -> None:
        wire.start()

    async def unplug() -> None:
        wire.stop()

    options = {"interface": "udp_multicast", "channel": group, "port": port, "timeout_s": timeout_s}
    plant = _canopen(make_bus("can", "canopen", options), said, nodes[0], "sdo", plug, unplug)
    plant.wire = wire
    plant.send, plant.stop = wire.send, [unplug]
    return plant


async def dbc(folder: Path, timeout_s: float = TIMEOUT_S) -> FaultyPlant:
    """Loggers that send by themselves, read by their DBC files."""
    adapter = SlcanAdapter([])
    said = temperatures(5)
    loggers = [CanLogger(source, adapter.send, first=0x300 + 0x10 * i) for i, source in enumerate(said)]
    plug, unplug = _cable(folder / "can", adapter.start, adapter.stop)
    await plug()
    for logger in loggers:
        logger.start()

    async def stop() -> None:
        for logger in loggers:
            logger.stop()
        await adapter.stop()

    bus = make_bus("can", "can", {"interface": "slcan", "channel": str(folder / "can"), "timeout_s": 2 * timeout_s})
    profiles = logger_profile(folder, "victim", 0x300), logger_profile(folder, "neighbour", 0x310)
    drivers = _pair(bus, profiles, {})
    plant = FaultyPlant(bus, drivers, said, loggers[0].faults, unplug, plug, wire=adapter, adapter=adapter, stop=[stop])
    plant.last_word = False
    return plant


async def _sensors(folder: Path, profile: str, payload: Payload, timeout_s: float) -> FaultyPlant:
    """Two displacement sensors on one line."""
    said = distances(1)
    victim, neighbour = (
        MeSensor(source, range_um=RANGE_UM, address=address, payload=payload)
        for source, address in zip(said, SENSORS, strict=True)
    )
    line = MeLine([victim, neighbour])
    plug, unplug = _cable(folder / "me", line.start, line.stop)
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
    """The same with the other form of data."""
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
WIRES: Mapping[str, str] = {
    "rtu": "Modbus RTU, `icpdas_m7015`",
    "pta": "Modbus RTU, `eletechsup_pta8d08`",
    "analogue": "Modbus RTU, `analogue_displacement`",
    "blocks": "Modbus RTU, a profile with two `[[block]]`",
    "tcp": "Modbus TCP, `advantech_adam6015`",
    "wago": "Modbus TCP, `wago_750_464`",
    "slcan": "CANopen by SDO, `slcan`",
    "heartbeat": "CANopen by SDO, heartbeat watched",
    "sync": "CANopen by SYNC, `slcan`",
    "timer": "CANopen by timer, `slcan`",
    "multicast": "CANopen by SDO, `udp_multicast`",
    "dbc": "plain CAN by DBC, `slcan`",
    "me_rs485": "RS-485, `me_rs485`",
    "dt6120": "RS-485, `me_dt6120`",
    "me_ethernet": "Ethernet, `me_ethernet`",
}
"""What a user calls each plant."""
