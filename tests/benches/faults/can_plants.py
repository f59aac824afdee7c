"""Plants of the fault matrix on CAN: CANopen nodes, and loggers that send by themselves."""

from collections.abc import Sequence
from pathlib import Path

from drivers.base import Bus
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.can_logger import CanLogger
from simulators.devices.multicast_bus import MulticastBus
from tests.benches.buses import make_bus
from tests.benches.faults.plant import NEIGHBOUR, TIMEOUT_S, VICTIM, FaultStep, FaultyPlant, cable, pair
from tests.benches.faults.said import Said, temperatures
from tests.benches.free_port import free_port
from tests.benches.logger_files import logger_profile

HEARTBEAT_MS, EVENT_MS = 80, 25


def _nodes(said: tuple[Said, Said], heartbeat_ms: int = 0, event_ms: int = 0) -> tuple[Cia404Node, Cia404Node]:
    def node(number: int, source: Said) -> Cia404Node:
        return Cia404Node(number, source, inputs=2, heartbeat_ms=heartbeat_ms, event_ms=event_ms)

    return node(VICTIM, said[0]), node(NEIGHBOUR, said[1])


def _canopen(
    bus: Bus, said: Sequence[Said], node: Cia404Node, transfer: str, plug: FaultStep, unplug: FaultStep
) -> FaultyPlant:
    drivers = pair(bus, ("cia404", "cia404"), {"vendor": "jumo", "transfer": transfer})
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
    plug, unplug = cable(folder / "can", adapter.start, adapter.stop)
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
    plug, unplug = cable(folder / "can", adapter.start, adapter.stop)
    await plug()
    for logger in loggers:
        logger.start()

    async def stop() -> None:
        for logger in loggers:
            logger.stop()
        await adapter.stop()

    bus = make_bus("can", "can", {"interface": "slcan", "channel": str(folder / "can"), "timeout_s": 2 * timeout_s})
    profiles = logger_profile(folder, "victim", 0x300), logger_profile(folder, "neighbour", 0x310)
    drivers = pair(bus, profiles, {})
    plant = FaultyPlant(bus, drivers, said, loggers[0].faults, unplug, plug, wire=adapter, adapter=adapter, stop=[stop])
    plant.last_word = False
    return plant
