"""Small plants for the fault matrix: one wire with a victim and a neighbour, over each transport."""

import socket
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drivers.base import Bus, Driver, SystemClock
from drivers.build import make_bus, make_device
from simulators.devices.adam6015 import Adam6015
from simulators.devices.can_logger import CanLogger
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine, MeSensor, Payload
from simulators.devices.modbus_servers import RtuLine, TcpHost
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.multicast_bus import MulticastBus
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.slcan_adapter import Frame, SlcanAdapter
from simulators.devices.source import Faults
from simulators.devices.spoil import Spoil
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from tests.drivers.logger_files import logger_profile

TIMEOUT_S = 0.045
HEARTBEAT_MS, EVENT_MS = 80, 25
VICTIM, NEIGHBOUR = 1, 2
SENSORS = (0x7E, 0x7D)
TEMPERATURE, DISTANCE_UM, RANGE_UM = 21.0, 250.0, 500.0
CHANNELS = {"victim": 0, "beside": 1}
"""Channel 0 of the victim is broken; channel 1 sits on the same device."""

Do = Callable[[], Awaitable[None]]


class Spoilable(Protocol):
    spoil: Spoil | None


@dataclass
class Plant:
    """One bus under test, its two devices, and what the test may do to them."""

    bus: Bus
    drivers: tuple[Driver, ...]
    faults: Faults
    unplug: Do
    plug: Do
    truth: float = TEMPERATURE
    wire: Spoilable | None = None
    adapter: SlcanAdapter | None = None
    node: Cia404Node | None = None
    send: Callable[[list[Frame]], None] = lambda _: None
    """Frames that somebody on a CAN bus sends."""
    retype: Callable[[int], None] = lambda _: None
    """Another type code at the victim's channel 0; 0 is the right one again."""
    stop: Sequence[Do] = ()


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


def _cable(link: Path, start: Callable[[], Awaitable[str]], stop: Do) -> tuple[Do, Do]:
    """Plug and unplug: a new terminal each time, under the same name."""

    async def plug() -> None:
        _point(link, await start())

    async def unplug() -> None:
        _point(link, None)
        await stop()

    return plug, unplug


class _Module(ModbusUnit, Protocol):
    faults: Faults


async def _rtu(folder: Path, profile: str, victim: _Module, neighbour: _Module, timeout_s: float = TIMEOUT_S) -> Plant:
    line = RtuLine({VICTIM: victim, NEIGHBOUR: neighbour})
    plug, unplug = _cable(folder / "rtu", line.start, line.stop)
    await plug()
    bus = make_bus("rtu", "modbus_rtu", {"port": str(folder / "rtu"), "baud": 115200, "timeout_s": timeout_s})
    return Plant(bus, _pair(bus, (profile, profile), {}), victim.faults, unplug, plug, wire=line, stop=[line.stop])


async def rtu(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Modbus RTU on a pseudo-terminal."""
    victim, neighbour = (M7015(lambda: [TEMPERATURE] * 6) for _ in range(2))
    plant = await _rtu(folder, "icpdas_m7015", victim, neighbour, timeout_s)
    plant.retype = lambda code: victim.set_type_code(0, code or 0x2E)
    return plant


async def pta(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Modbus RTU with modules that do not notice broken sensors."""
    victim, neighbour = (Pta8d08(lambda: [TEMPERATURE] * 8) for _ in range(2))
    return await _rtu(folder, "eletechsup_pta8d08", victim, neighbour, timeout_s)


async def analogue(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Analogue displacement sensors on voltage input modules."""
    victim, neighbour = (VoltageInput(lambda: [DISTANCE_UM] * 8, range_um=RANGE_UM) for _ in range(2))
    plant = await _rtu(folder, "analogue_displacement", victim, neighbour, timeout_s)
    plant.truth = DISTANCE_UM
    return plant


async def _tcp(profile: str, victim: _Module, neighbour: _Module, timeout_s: float = TIMEOUT_S) -> Plant:
    host = TcpHost({VICTIM: victim, NEIGHBOUR: neighbour})
    port = await host.start()

    async def plug() -> None:
        await host.start(port)

    bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": timeout_s})
    return Plant(bus, _pair(bus, (profile, profile), {}), victim.faults, host.stop, plug, wire=host, stop=[host.stop])


async def tcp(_: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Modbus TCP on loopback, two units behind one host."""
    victim, neighbour = (Adam6015(lambda: [TEMPERATURE] * 7) for _ in range(2))
    plant = await _tcp("advantech_adam6015", victim, neighbour, timeout_s)
    plant.retype = lambda code: victim.set_type_code(0, code or 0x03A4)
    return plant


async def wago(_: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Modules behind couplers: only the status byte tells."""
    victim, neighbour = (Wago464(lambda: [TEMPERATURE] * 4) for _ in range(2))
    return await _tcp("wago_750_464", victim, neighbour, timeout_s)


async def other() -> Plant:
    """A healthy bus of its own."""
    device = Adam6015(lambda: [TEMPERATURE] * 7)
    host = TcpHost({1: device})
    bus = make_bus("other", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    driver = make_device("other", bus, "advantech_adam6015", 1, {"other": 0}, {}, SystemClock())
    return Plant(bus, (driver,), device.faults, host.stop, host.stop, stop=[host.stop])


def _nodes(heartbeat_ms: int = 0, event_ms: int = 0) -> tuple[Cia404Node, Cia404Node]:
    def node(number: int) -> Cia404Node:
        return Cia404Node(number, lambda: [TEMPERATURE] * 2, inputs=2, heartbeat_ms=heartbeat_ms, event_ms=event_ms)

    return node(VICTIM), node(NEIGHBOUR)


def _canopen(bus: Bus, nodes: tuple[Cia404Node, Cia404Node], transfer: str, plug: Do, unplug: Do) -> Plant:
    node = nodes[0]
    drivers = _pair(bus, ("cia404", "cia404"), {"vendor": "jumo", "transfer": transfer})
    plant = Plant(bus, drivers, node.faults, unplug, plug, node=node)
    plant.retype = lambda code: node.set_sensor_type(0, code or 30)
    return plant


async def _slcan(
    folder: Path, transfer: str, timeout_s: float = TIMEOUT_S, heartbeat_ms: int = 0, event_ms: int = 0
) -> Plant:
    nodes = _nodes(heartbeat_ms, event_ms)
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
    plant = _canopen(make_bus("can", "canopen", options), nodes, transfer, plug, unplug)
    plant.adapter = plant.wire = adapter
    plant.send, plant.stop = adapter.send, [stop]
    return plant


async def slcan(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """CANopen by SDO through a serial CAN adapter."""
    return await _slcan(folder, "sdo", timeout_s)


async def heartbeat(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """The same, heartbeats watched."""
    return await _slcan(folder, "sdo", timeout_s, heartbeat_ms=HEARTBEAT_MS)


async def sync(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """CANopen by TPDOs after SYNC, heartbeats watched."""
    return await _slcan(folder, "sync", timeout_s, heartbeat_ms=HEARTBEAT_MS)


async def timer(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """CANopen by TPDOs that the nodes send by their timers, heartbeats watched."""
    return await _slcan(folder, "timer", timeout_s, heartbeat_ms=HEARTBEAT_MS, event_ms=EVENT_MS)


async def multicast(_: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """CANopen over UDP multicast, as between two programs."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = int(probe.getsockname()[1])
    nodes, group = _nodes(), "239.74.163.4"
    wire = MulticastBus(nodes, group, port)
    wire.start()

    async def plug() -> None:
        wire.start()

    async def unplug() -> None:
        wire.stop()

    options = {"interface": "udp_multicast", "channel": group, "port": port, "timeout_s": timeout_s}
    plant = _canopen(make_bus("can", "canopen", options), nodes, "sdo", plug, unplug)
    plant.wire = wire
    plant.send, plant.stop = wire.send, [unplug]
    return plant


async def dbc(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Loggers that send by themselves, read by their DBC files."""
    adapter = SlcanAdapter([])
    loggers = [CanLogger(lambda: [TEMPERATURE] * 5, adapter.send, first=first) for first in (0x300, 0x310)]
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
    return Plant(bus, drivers, loggers[0].faults, unplug, plug, wire=adapter, adapter=adapter, stop=[stop])


async def _sensors(folder: Path, profile: str, payload: Payload, timeout_s: float) -> Plant:
    """Two displacement sensors on one line."""
    victim, neighbour = (
        MeSensor(lambda: [DISTANCE_UM], range_um=RANGE_UM, address=address, payload=payload) for address in SENSORS
    )
    line = MeLine([victim, neighbour])
    plug, unplug = _cable(folder / "me", line.start, line.stop)
    await plug()
    bus = make_bus("me", "me_rs485", {"port": str(folder / "me"), "timeout_s": timeout_s})
    drivers = tuple(
        make_device(name, bus, profile, address, {name: 0}, {"range_um": RANGE_UM}, SystemClock())
        for name, address in zip(("victim", "neighbour"), SENSORS, strict=True)
    )
    return Plant(bus, drivers, victim.faults, unplug, plug, DISTANCE_UM, wire=line, stop=[line.stop])


async def me_rs485(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """Displacement sensors on a pseudo-terminal."""
    return await _sensors(folder, "me_rs485", "float", timeout_s)


async def dt6120(folder: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """The same with the other form of data."""
    return await _sensors(folder, "me_dt6120", "counted", timeout_s)


async def me_ethernet(_: Path, timeout_s: float = TIMEOUT_S) -> Plant:
    """One displacement controller on loopback."""
    controller = MeController(lambda: [DISTANCE_UM] * 2, range_um=RANGE_UM)
    port = await controller.start()

    async def plug() -> None:
        await controller.start(port)

    bus = make_bus("eddy", "me_ethernet", {"host": "127.0.0.1", "port": port, "timeout_s": 2 * timeout_s})
    driver = make_device("victim", bus, "me_ethernet", 1, CHANNELS, {"range_um": RANGE_UM}, SystemClock())
    stop = [controller.stop]
    return Plant(bus, (driver,), controller.faults, controller.stop, plug, DISTANCE_UM, wire=controller, stop=stop)


class Make(Protocol):
    """A plant on a new wire, its devices' names in an empty folder."""

    def __call__(self, folder: Path, /, timeout_s: float = TIMEOUT_S) -> Awaitable[Plant]: ...


PLANTS: Mapping[str, Make] = {
    "rtu": rtu,
    "pta": pta,
    "analogue": analogue,
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
WIRES: Mapping[str, str] = {
    "rtu": "Modbus RTU, `icpdas_m7015`",
    "pta": "Modbus RTU, `eletechsup_pta8d08`",
    "analogue": "Modbus RTU, `analogue_displacement`",
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
