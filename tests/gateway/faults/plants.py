"""Small plants for the fault matrix: one wire with a victim and a neighbour, over each transport."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from drivers.base import Bus, Driver, SystemClock
from drivers.build import make_bus, make_device
from simulators.devices.adam6015 import Adam6015
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeSensor
from simulators.devices.modbus_servers import RtuLine, TcpHost
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.slcan_adapter import SlcanAdapter
from simulators.devices.source import Faults
from simulators.devices.spoil import Spoil

TIMEOUT_S = 0.03
HEARTBEAT_MS = 50
VICTIM, NEIGHBOUR = 1, 2
TEMPERATURES = [21.0] * 8
CHANNELS = {"victim": 0, "beside": 1}
"""Channel 0 of the victim is broken; channel 1 sits on the same device."""


class Spoilable(Protocol):
    spoil: Spoil | None


@dataclass
class Plant:
    """One bus under test, its two devices, and what the test may do to them."""

    bus: Bus
    drivers: tuple[Driver, ...]
    faults: Faults
    unplug: Callable[[], Awaitable[None]]
    plug: Callable[[], Awaitable[None]]
    wire: Spoilable | None = None
    adapter: SlcanAdapter | None = None
    node: Cia404Node | None = None
    retype: Callable[[int], None] = lambda _: None
    """Another type code at the victim's channel 0; 0 is the right one again."""
    stop: list[Callable[[], Awaitable[None]]] = field(default_factory=list)


def _pair(bus: Bus, profile: str, options: Mapping[str, object]) -> tuple[Driver, Driver]:
    clock = SystemClock()
    return (
        make_device("victim", bus, profile, VICTIM, CHANNELS, options, clock),
        make_device("neighbour", bus, profile, NEIGHBOUR, {"neighbour": 0}, options, clock),
    )


def _point(link: Path, path: str | None) -> None:
    """What udev does: the name is there while the adapter is."""
    link.unlink(missing_ok=True)
    if path is not None:
        link.symlink_to(path)


def _cable(
    link: Path, start: Callable[[], Awaitable[str]], stop: Callable[[], Awaitable[None]]
) -> tuple[Callable[[], Awaitable[None]], Callable[[], Awaitable[None]]]:
    """Plug and unplug: a new terminal each time, under the same name."""

    async def plug() -> None:
        _point(link, await start())

    async def unplug() -> None:
        _point(link, None)
        await stop()

    return plug, unplug


async def rtu(folder: Path, victim: M7015 | Pta8d08 | None = None) -> Plant:
    """Modbus RTU on a pseudo-terminal."""
    device = victim or M7015(lambda: TEMPERATURES[:6])
    neighbour = M7015(lambda: TEMPERATURES[:6]) if isinstance(device, M7015) else Pta8d08(lambda: TEMPERATURES)
    line = RtuLine({VICTIM: device, NEIGHBOUR: neighbour})
    plug, unplug = _cable(folder / "rtu", line.start, line.stop)
    await plug()
    options = {"port": str(folder / "rtu"), "baud": 115200, "timeout_s": TIMEOUT_S}
    bus = make_bus("rtu", "modbus_rtu", options)
    profile = "icpdas_m7015" if isinstance(device, M7015) else "eletechsup_pta8d08"
    plant = Plant(bus, _pair(bus, profile, {}), device.faults, unplug, plug, line, stop=[line.stop])
    if isinstance(device, M7015):
        plant.retype = lambda code: device.set_type_code(0, code or 0x2E)
    return plant


async def pta(folder: Path) -> Plant:
    """Modbus RTU with modules that do not notice broken sensors."""
    return await rtu(folder, Pta8d08(lambda: TEMPERATURES))


async def tcp(folder: Path) -> Plant:
    """Modbus TCP on loopback, two units behind one host."""
    device = Adam6015(lambda: TEMPERATURES[:7])
    host = TcpHost({VICTIM: device, NEIGHBOUR: Adam6015(lambda: TEMPERATURES[:7])})
    port = await host.start()

    async def plug() -> None:
        await host.start(port)

    bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S})
    drivers = _pair(bus, "advantech_adam6015", {})
    plant = Plant(bus, drivers, device.faults, host.stop, plug, host, stop=[host.stop])
    plant.retype = lambda code: device.set_type_code(0, code or 0x03A4)
    return plant


async def other() -> Plant:
    """A healthy bus of its own."""
    device = Adam6015(lambda: TEMPERATURES[:7])
    host = TcpHost({1: device})
    bus = make_bus("other", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    driver = make_device("other", bus, "advantech_adam6015", 1, {"other": 0}, {}, SystemClock())
    return Plant(bus, (driver,), device.faults, host.stop, host.stop, stop=[host.stop])


async def slcan(folder: Path, heartbeat_ms: int = 0) -> Plant:
    """CANopen by SDO through a serial CAN adapter."""
    node = Cia404Node(VICTIM, lambda: TEMPERATURES[:2], inputs=2, heartbeat_ms=heartbeat_ms)
    adapter = SlcanAdapter([node, Cia404Node(NEIGHBOUR, lambda: TEMPERATURES[:2], inputs=2)])
    node.start(adapter.send)

    async def stop() -> None:
        node.stop()
        await adapter.stop()

    plug, unplug = _cable(folder / "can", adapter.start, adapter.stop)
    await plug()
    options = {"interface": "slcan", "channel": str(folder / "can"), "timeout_s": TIMEOUT_S}
    bus = make_bus("can", "canopen", options)
    drivers = _pair(bus, "cia404", {"vendor": "jumo"})
    plant = Plant(bus, drivers, node.faults, unplug, plug, adapter=adapter, node=node, stop=[stop])
    plant.retype = lambda code: node.set_sensor_type(0, code or 30)
    return plant


async def slcan_heartbeat(folder: Path) -> Plant:
    """The same, the victim's heartbeat watched."""
    return await slcan(folder, HEARTBEAT_MS)


async def me_rs485(folder: Path) -> Plant:
    """One displacement sensor on a pseudo-terminal."""
    sensor = MeSensor(lambda: [250.0], range_um=500.0)
    plug, unplug = _cable(folder / "me", sensor.start, sensor.stop)
    await plug()
    bus = make_bus("me", "me_rs485", {"port": str(folder / "me"), "timeout_s": TIMEOUT_S})
    driver = make_device("victim", bus, "me_rs485", 0x7E, {"victim": 0}, {"range_um": 500.0}, SystemClock())
    return Plant(bus, (driver,), sensor.faults, unplug, plug, stop=[sensor.stop])


async def me_ethernet(folder: Path) -> Plant:
    """One displacement controller on loopback."""
    controller = MeController(lambda: [250.0, 250.0], range_um=500.0)
    port = await controller.start()

    async def plug() -> None:
        await controller.start(port)

    bus = make_bus("eddy", "me_ethernet", {"host": "127.0.0.1", "port": port, "timeout_s": 0.1})
    driver = make_device("victim", bus, "me_ethernet", 1, CHANNELS, {"range_um": 500.0}, SystemClock())
    return Plant(bus, (driver,), controller.faults, controller.stop, plug, stop=[controller.stop])


PLANTS: Mapping[str, Callable[[Path], Awaitable[Plant]]] = {
    "rtu": rtu,
    "pta": pta,
    "tcp": tcp,
    "slcan": slcan,
    "me_rs485": me_rs485,
    "me_ethernet": me_ethernet,
}

PLANTS_OF_ONE_FAULT: Mapping[str, Callable[[Path], Awaitable[Plant]]] = {"slcan_heartbeat": slcan_heartbeat}
