"""The devices of the contract test, each emulated on its real wire: loopback TCP and pseudo-terminals."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Protocol

from drivers.base import Bus, Driver, Quality, SystemClock
from drivers.build import make_device
from simulators.devices import M7015, Adam6015, Cia404Node, DeviceServer, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.can_logger import CanLogger
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine, Payload
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.source import Faults, SensorFault
from simulators.devices.spoil import Spoil
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from tests.benches.buses import make_bus
from tests.benches.logger_files import logger_profile

TIMEOUT_S = 0.1
TEMPERATURES = [20.04, 21.26, -3.3, 40.0, 99.96, 22.22, 23.456]
DISTANCE_UM = [123.4]
NEIGHBOUR = 10.0
"""What every channel of a neighbour measures."""


class Spoilable(Protocol):
    """A wire whose answers a test changes."""

    spoil: Spoil | None


@dataclass
class Rig:
    """One kind of bus with a device on it, and a neighbour where the wire carries several."""

    kind: str
    unit: str
    true_values: list[float]
    tolerance: float
    """Half the device's quantisation step."""
    faults: Faults
    options: dict[str, object]
    make: Callable[[Bus], Driver]
    stop_wire: Callable[[], Awaitable[None]]
    fault_qualities: Mapping[SensorFault, Quality]
    make_neighbour: Callable[[Bus], Driver]
    spoil_identity: Callable[[], None]
    wire: Spoilable
    settle_s: float = 0.0
    """For a device that sends by itself: how long until a change is seen and what came before is too old. The whole of
    it passes in simulated time, however busy the computer is."""
    by_frames: bool = False
    """Whether each value is as old as the frame that brought it."""

    async def break_sensor(self, channel: int, fault: SensorFault | None) -> None:
        self.faults.set(channel, fault)
        await asyncio.sleep(self.settle_s)

    async def silence(self, silent: bool = True) -> None:
        self.faults.silent = silent
        await asyncio.sleep(self.settle_s)

    async def cut_wire(self) -> None:
        await self.stop_wire()
        await asyncio.sleep(self.settle_s)

    @asynccontextmanager
    async def connected(self) -> AsyncIterator[tuple[Bus, Driver]]:
        bus = make_bus("bus1", self.kind, self.options)
        driver = self.make(bus)
        try:
            await bus.connect()
            await driver.connect()
            yield bus, driver
        finally:
            await driver.close()
            await bus.close()


def _maker(
    profile: str, unit: int, count: int, options: Mapping[str, object], name: str = "device1"
) -> Callable[[Bus], Driver]:
    channels = {f"channel{i}": i for i in range(count)}
    return lambda bus: make_device(name, bus, profile, unit, channels, options, SystemClock())


StartRig = Callable[[AsyncExitStack], Awaitable[Rig]]


async def _rtu_rig(stack: AsyncExitStack) -> Rig:
    device, neighbour = M7015(lambda: TEMPERATURES[:6]), M7015(lambda: [NEIGHBOUR] * 6)
    line = RtuLine({3: device, 4: neighbour})
    path = await line.start()
    stack.push_async_callback(line.stop)
    broken = Quality.SENSOR_FAULT
    return Rig(
        kind="modbus_rtu",
        unit="degC",
        true_values=TEMPERATURES[:6],
        tolerance=0.05,
        faults=device.faults,
        options={"port": path, "baud": 115200, "timeout_s": TIMEOUT_S},
        make=_maker("icpdas_m7015", 3, 6, {}),
        stop_wire=line.stop,
        wire=line,
        make_neighbour=_maker("icpdas_m7015", 4, 6, {}, "neighbour"),
        spoil_identity=lambda: device.set_type_code(2, 0x2B),  # copper
        fault_qualities={
            SensorFault.OPEN: broken,
            SensorFault.SHORT: broken,
            SensorFault.OVER: broken,
            SensorFault.UNDER: broken,
        },
    )


async def _tcp_rig(stack: AsyncExitStack) -> Rig:
    device, neighbour = Adam6015(lambda: TEMPERATURES), Adam6015(lambda: [NEIGHBOUR] * 7)
    host = TcpHost({1: device, 2: neighbour})
    port = await host.start()
    stack.push_async_callback(host.stop)
    beyond = Quality.OUT_OF_RANGE
    return Rig(
        kind="modbus_tcp",
        unit="degC",
        true_values=TEMPERATURES,
        tolerance=200 / 65535 / 2,
        faults=device.faults,
        options={"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S},
        make=_maker("advantech_adam6015", 1, 7, {}),
        stop_wire=host.stop,
        wire=host,
        make_neighbour=_maker("advantech_adam6015", 2, 7, {}, "neighbour"),
        spoil_identity=lambda: device.set_type_code(6, 0x0103),  # millivolts
        fault_qualities={
            SensorFault.OPEN: Quality.SENSOR_FAULT,
            SensorFault.SHORT: beyond,
            SensorFault.OVER: beyond,
            SensorFault.UNDER: beyond,
        },
    )


def _plain_rig(
    kind: str,
    profile: str,
    count: int,
    device: Wago464 | Pta8d08 | VoltageInput,
    neighbour: Wago464 | Pta8d08 | VoltageInput,
    qualities: Sequence[Quality],
    *,
    truth: Sequence[float] = TEMPERATURES,
    unit: str = "degC",
    step: float = 0.1,
    options: Mapping[str, object] = MappingProxyType({}),
) -> StartRig:
    """A Modbus module without type codes as unit 1; qualities of open, short, over, under."""

    async def start(stack: AsyncExitStack) -> Rig:
        wire: RtuLine | TcpHost | DeviceServer
        if kind == "modbus_rtu":
            wire = RtuLine({1: device, 2: neighbour})
            address: dict[str, object] = {"port": await wire.start(), "baud": 115200}
        else:
            wire = (TcpHost if kind == "modbus_tcp" else DeviceServer)({1: device, 2: neighbour})
            address = {"host": "127.0.0.1", "port": await wire.start()}
        stack.push_async_callback(wire.stop)
        return Rig(
            kind=kind,
            unit=unit,
            true_values=list(truth[:count]),
            tolerance=step / 2,
            faults=device.faults,
            options=address | {"timeout_s": TIMEOUT_S},
            make=_maker(profile, 1, count, options),
            stop_wire=wire.stop,
            wire=wire,
            make_neighbour=_maker(profile, 2, count, {}, "neighbour"),
            spoil_identity=_no_identity,
            fault_qualities=dict(zip(SensorFault, qualities, strict=True)),
        )

    return start


def _wago(stack: AsyncExitStack) -> Awaitable[Rig]:
    device, neighbour = Wago464(lambda: TEMPERATURES[:4], start=8), Wago464(lambda: [NEIGHBOUR] * 4)
    qualities = [Quality.SENSOR_FAULT, Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE]
    return _plain_rig("modbus_tcp", "wago_750_464", 4, device, neighbour, qualities, options={"address_offset": 8})(
        stack
    )


def _pta(stack: AsyncExitStack, kind: str = "modbus_rtu") -> Awaitable[Rig]:
    """A rig whose open input shows 97.7 degC, so no machine part may be near that."""
    truth = [20.04, 21.26, -3.3, 40.0, 94.96, 22.22, 23.456, 0.0]
    device, neighbour = Pta8d08(lambda: truth), Pta8d08(lambda: [NEIGHBOUR] * 8)
    qualities = [Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE]
    return _plain_rig(kind, "eletechsup_pta8d08", 8, device, neighbour, qualities, truth=truth)(stack)


def _voltage(stack: AsyncExitStack) -> Awaitable[Rig]:
    truth = [5.02, 250.0, 499.99, 123.45, 60.0, 70.0, 80.0, 90.0]
    device, neighbour = (
        VoltageInput(lambda: truth, range_um=500.0),
        VoltageInput(lambda: [NEIGHBOUR] * 8, range_um=500.0),
    )
    return _plain_rig(
        "modbus_rtu",
        "analogue_displacement",
        8,
        device,
        neighbour,
        [Quality.OUT_OF_RANGE] * 4,
        truth=truth,
        unit="µm",
        step=0.05,
    )(stack)


def _can_rig(vendor: str, short: Quality, transfer: str = "sdo") -> StartRig:
    async def start(stack: AsyncExitStack) -> Rig:
        event_ms = 60 if transfer == "timer" else 0
        node = Cia404Node(5, lambda: TEMPERATURES[:4], inputs=4, vendor=vendor, event_ms=event_ms)
        neighbour = Cia404Node(6, lambda: [NEIGHBOUR] * 4, inputs=4, event_ms=event_ms)
        adapter = SlcanAdapter([node, neighbour])
        path = await adapter.start()
        stack.push_async_callback(adapter.stop)
        for sending in (node, neighbour):
            sending.start(adapter.send)
            stack.callback(sending.stop)
        return Rig(
            kind="canopen",
            unit="degC",
            true_values=TEMPERATURES[:4],
            tolerance=0.05,
            faults=node.faults,
            options={"interface": "slcan", "channel": path, "bitrate": 125000, "timeout_s": TIMEOUT_S},
            make=_maker("cia404", 5, 4, {"vendor": vendor, "transfer": transfer}),
            stop_wire=adapter.stop,
            wire=adapter,
            make_neighbour=_maker("cia404", 6, 4, {"vendor": "jumo", "transfer": transfer}, "neighbour"),
            spoil_identity=lambda: node.set_sensor_type(1, 1),  # thermocouple
            settle_s=4 * event_ms / 1000,
            by_frames=transfer != "sdo",
            fault_qualities={
                SensorFault.OPEN: Quality.SENSOR_FAULT,
                SensorFault.SHORT: short,
                SensorFault.OVER: Quality.OUT_OF_RANGE,
                SensorFault.UNDER: Quality.OUT_OF_RANGE,
            },
        )

    return start


async def _dbc_rig(stack: AsyncExitStack) -> Rig:
    """Two loggers that send by themselves; how old their frames may be is the bus's timeout."""
    folder = Path(stack.enter_context(TemporaryDirectory()))
    adapter = SlcanAdapter([])
    logger = CanLogger(lambda: TEMPERATURES[:5], adapter.send)
    neighbour = CanLogger(lambda: [NEIGHBOUR] * 5, adapter.send, first=0x310)
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    for sending in (logger, neighbour):
        sending.start()
        stack.callback(sending.stop)
    return Rig(
        kind="can",
        unit="degC",
        true_values=TEMPERATURES[:5],
        tolerance=0.05,
        faults=logger.faults,
        options={"interface": "slcan", "channel": path, "timeout_s": TIMEOUT_S},
        make=_maker(logger_profile(folder, "logger", 0x300), 1, 5, {}),
        by_frames=True,
        stop_wire=adapter.stop,
        wire=adapter,
        make_neighbour=_maker(logger_profile(folder, "neighbour", 0x310), 2, 5, {}, "neighbour"),
        spoil_identity=_no_identity,
        fault_qualities={
            SensorFault.OPEN: Quality.SENSOR_FAULT,
            SensorFault.SHORT: Quality.SENSOR_FAULT,
            SensorFault.OVER: Quality.OUT_OF_RANGE,
            SensorFault.UNDER: Quality.OUT_OF_RANGE,
        },
        settle_s=1.5 * TIMEOUT_S,
    )


def _no_neighbour(bus: Bus) -> Driver:
    raise NotImplementedError(f"{bus.name} carries one device")


def _no_identity() -> None:
    raise NotImplementedError("this device does not tell what is connected")


def _displacement_rig(profile: str, payload: Payload, step: float, broken: Quality) -> StartRig:
    async def start(stack: AsyncExitStack) -> Rig:
        sensor = MeSensor(lambda: DISTANCE_UM, range_um=500.0, payload=payload)
        neighbour = MeSensor(lambda: [NEIGHBOUR], range_um=500.0, address=125, payload=payload)
        line = MeLine([sensor, neighbour])
        path = await line.start()
        stack.push_async_callback(line.stop)
        return Rig(
            kind="me_rs485",
            unit="µm",
            true_values=DISTANCE_UM,
            tolerance=step / 2,
            faults=sensor.faults,
            options={"port": path, "baud": 230400, "timeout_s": TIMEOUT_S},
            make=_maker(profile, 126, 1, {"range_um": 500.0}),
            stop_wire=line.stop,
            wire=line,
            make_neighbour=_maker(profile, 125, 1, {"range_um": 500.0}, "neighbour"),
            spoil_identity=_no_identity,
            fault_qualities={
                SensorFault.OPEN: broken,
                SensorFault.SHORT: broken,
                SensorFault.OVER: Quality.OUT_OF_RANGE,
                SensorFault.UNDER: Quality.OUT_OF_RANGE,
            },
        )

    return start


async def _ethernet_rig(stack: AsyncExitStack) -> Rig:
    controller = MeController(lambda: [123.4, 250.0], range_um=500.0)
    port = await controller.start()
    stack.push_async_callback(controller.stop)
    return Rig(
        kind="me_ethernet",
        unit="µm",
        true_values=[123.4, 250.0],
        tolerance=500 / 0xFFFFFF / 2,
        faults=controller.faults,
        options={"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S},
        make=_maker("me_ethernet", 1, 2, {"range_um": 500.0}),
        stop_wire=controller.stop,
        wire=controller,
        make_neighbour=_no_neighbour,
        spoil_identity=_no_identity,
        fault_qualities=dict.fromkeys(SensorFault, Quality.OUT_OF_RANGE),
    )


RIGS: dict[str, StartRig] = {
    "m7015": _rtu_rig,
    "adam6015": _tcp_rig,
    "cia404-jumo": _can_rig("jumo", Quality.SENSOR_FAULT),
    "cia404-axiomatic": _can_rig("axiomatic", Quality.OUT_OF_RANGE),
    "cia404-esd": _can_rig("esd", Quality.SENSOR_FAULT),
    "cia404-sync": _can_rig("jumo", Quality.SENSOR_FAULT, "sync"),
    "cia404-timer": _can_rig("jumo", Quality.SENSOR_FAULT, "timer"),
    "can_dbc": _dbc_rig,
    "wago464": _wago,
    "pta8d08": _pta,
    "pta8d08-device-server": partial(_pta, kind="modbus_rtu_tcp"),
    "voltage": _voltage,
    "me_rs485": _displacement_rig("me_rs485", "float", 500 * 2**-23, Quality.SENSOR_FAULT),
    "me_ethernet": _ethernet_rig,
    "me_dt6120": _displacement_rig("me_dt6120", "counted", 500 / 0xF00000, Quality.OUT_OF_RANGE),
}
SHARED = [name for name in RIGS if name != "me_ethernet"]
"""Wires that carry several devices."""
TYPED = [name for name in RIGS if name.startswith(("m7015", "adam", "cia404"))]
"""Devices that tell which sensor is connected."""
