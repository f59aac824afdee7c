"""What every device driver does, shown over the real wire: loopback TCP and pseudo-terminals."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from datetime import timedelta
from math import isnan
from types import MappingProxyType

import pytest

from drivers.base import Bus, ConnectError, Driver, DriverError, NoAnswer, Quality, SystemClock, WrongDevice
from drivers.build import make_bus, make_device
from simulators.devices.adam6015 import Adam6015
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeSensor, Payload
from simulators.devices.modbus_servers import RtuLine, TcpHost
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.slcan_adapter import SlcanAdapter
from simulators.devices.source import Fault, Faults
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464

TIMEOUT_S = 0.1
TEMPERATURES = [20.04, 21.26, -3.3, 40.0, 99.96, 22.22, 23.456]
DISTANCE_UM = [123.4]
NEIGHBOUR = 10.0
"""What every channel of a neighbour measures."""


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
    fault_qualities: Mapping[Fault, Quality]
    make_neighbour: Callable[[Bus], Driver]
    spoil_identity: Callable[[], None]

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
        make_neighbour=_maker("icpdas_m7015", 4, 6, {}, "neighbour"),
        spoil_identity=lambda: device.set_type_code(2, 0x2B),  # copper
        fault_qualities={Fault.OPEN: broken, Fault.SHORT: broken, Fault.OVER: broken, Fault.UNDER: broken},
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
        make_neighbour=_maker("advantech_adam6015", 2, 7, {}, "neighbour"),
        spoil_identity=lambda: device.set_type_code(6, 0x0103),  # millivolts
        fault_qualities={
            Fault.OPEN: Quality.SENSOR_FAULT,
            Fault.SHORT: beyond,
            Fault.OVER: beyond,
            Fault.UNDER: beyond,
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
        wire: RtuLine | TcpHost
        if kind == "modbus_rtu":
            wire = RtuLine({1: device, 2: neighbour})
            address: dict[str, object] = {"port": await wire.start(), "baud": 115200}
        else:
            wire = TcpHost({1: device, 2: neighbour})
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
            make_neighbour=_maker(profile, 2, count, {}, "neighbour"),
            spoil_identity=_no_identity,
            fault_qualities=dict(zip(Fault, qualities, strict=True)),
        )

    return start


def _wago(stack: AsyncExitStack) -> Awaitable[Rig]:
    device, neighbour = Wago464(lambda: TEMPERATURES[:4], start=8), Wago464(lambda: [NEIGHBOUR] * 4)
    qualities = [Quality.SENSOR_FAULT, Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE]
    return _plain_rig("modbus_tcp", "wago_750_464", 4, device, neighbour, qualities, options={"address_offset": 8})(
        stack
    )


def _pta(stack: AsyncExitStack) -> Awaitable[Rig]:
    """An open input shows 97.7 degC, so no machine part may be near that."""
    truth = [20.04, 21.26, -3.3, 40.0, 94.96, 22.22, 23.456, 0.0]
    device, neighbour = Pta8d08(lambda: truth), Pta8d08(lambda: [NEIGHBOUR] * 8)
    qualities = [Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE, Quality.OUT_OF_RANGE]
    return _plain_rig("modbus_rtu", "eletechsup_pta8d08", 8, device, neighbour, qualities, truth=truth)(stack)


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
        node = Cia404Node(5, lambda: TEMPERATURES[:4], inputs=4, vendor=vendor)
        neighbour = Cia404Node(6, lambda: [NEIGHBOUR] * 4, inputs=4)
        adapter = SlcanAdapter([node, neighbour])
        path = await adapter.start()
        stack.push_async_callback(adapter.stop)
        return Rig(
            kind="canopen",
            unit="degC",
            true_values=TEMPERATURES[:4],
            tolerance=0.05,
            faults=node.faults,
            options={"interface": "slcan", "channel": path, "bitrate": 125000, "timeout_s": TIMEOUT_S},
            make=_maker("cia404", 5, 4, {"vendor": vendor, "transfer": transfer}),
            stop_wire=adapter.stop,
            make_neighbour=_maker("cia404", 6, 4, {"vendor": "jumo", "transfer": transfer}, "neighbour"),
            spoil_identity=lambda: node.set_sensor_type(1, 1),  # thermocouple
            fault_qualities={
                Fault.OPEN: Quality.SENSOR_FAULT,
                Fault.SHORT: short,
                Fault.OVER: Quality.OUT_OF_RANGE,
                Fault.UNDER: Quality.OUT_OF_RANGE,
            },
        )

    return start


def _no_neighbour(bus: Bus) -> Driver:
    raise NotImplementedError(f"{bus.name} carries one device")


def _no_identity() -> None:
    raise NotImplementedError("this device does not tell what is connected")


def _displacement_rig(profile: str, payload: Payload, step: float, broken: Quality) -> StartRig:
    async def start(stack: AsyncExitStack) -> Rig:
        sensor = MeSensor(lambda: DISTANCE_UM, range_um=500.0, payload=payload)
        path = await sensor.start()
        stack.push_async_callback(sensor.stop)
        return Rig(
            kind="me_rs485",
            unit="µm",
            true_values=DISTANCE_UM,
            tolerance=step / 2,
            faults=sensor.faults,
            options={"port": path, "baud": 230400, "timeout_s": TIMEOUT_S},
            make=_maker(profile, 126, 1, {"range_um": 500.0}),
            stop_wire=sensor.stop,
            make_neighbour=_no_neighbour,
            spoil_identity=_no_identity,
            fault_qualities={
                Fault.OPEN: broken,
                Fault.SHORT: broken,
                Fault.OVER: Quality.OUT_OF_RANGE,
                Fault.UNDER: Quality.OUT_OF_RANGE,
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
        make_neighbour=_no_neighbour,
        spoil_identity=_no_identity,
        fault_qualities=dict.fromkeys(Fault, Quality.OUT_OF_RANGE),
    )


RIGS: dict[str, StartRig] = {
    "m7015": _rtu_rig,
    "adam6015": _tcp_rig,
    "cia404-jumo": _can_rig("jumo", Quality.SENSOR_FAULT),
    "cia404-axiomatic": _can_rig("axiomatic", Quality.OUT_OF_RANGE),
    "cia404-esd": _can_rig("esd", Quality.SENSOR_FAULT),
    "cia404-sync": _can_rig("jumo", Quality.SENSOR_FAULT, "sync"),
    "wago464": _wago,
    "pta8d08": _pta,
    "voltage": _voltage,
    "me_rs485": _displacement_rig("me_rs485", "float", 500 * 2**-23, Quality.SENSOR_FAULT),
    "me_ethernet": _ethernet_rig,
    "me_dt6120": _displacement_rig("me_dt6120", "counted", 500 / 0xF00000, Quality.OUT_OF_RANGE),
}
SHARED = [name for name in RIGS if not name.startswith("me_")]
"""Wires that carry several devices."""
TYPED = [name for name in RIGS if name.startswith(("m7015", "adam", "cia404"))]
"""Devices that tell which sensor is connected."""


@pytest.fixture(params=RIGS)
async def rig(request: pytest.FixtureRequest) -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        yield await RIGS[request.param](stack)


async def test_values_arrive_within_quantisation(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        readings = await driver.read()
    assert [r.channel for r in readings] == list(driver.channels)
    assert {r.unit for r in readings} == {rig.unit}
    assert {r.quality for r in readings} == {Quality.GOOD}
    assert [r.value for r in readings] == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


async def test_readings_carry_times_and_count_the_reads(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        first, second = await driver.read(), await driver.read()
    assert {r.sequence for r in second} == {first[0].sequence + 1}
    assert second[0].monotonic_s > first[0].monotonic_s
    assert second[0].source_time.utcoffset() == timedelta(0)


async def test_each_sensor_fault_is_told_on_its_channel_alone(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        for fault, quality in rig.fault_qualities.items():
            rig.faults.set(0, fault)
            broken, *others = await driver.read()
            assert (fault, broken.quality) == (fault, quality)
            assert isnan(broken.value)
            assert broken.detail
            assert {r.quality for r in others} <= {Quality.GOOD}
        rig.faults.set(0, None)
        assert (await driver.read())[0].quality is Quality.GOOD


async def test_silent_device_is_told_in_time_and_comes_back(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        rig.faults.silent = True
        started = time.monotonic()
        with pytest.raises(NoAnswer) as caught:
            await driver.read()
        assert time.monotonic() - started < 3 * TIMEOUT_S
        assert (caught.value.bus, caught.value.device) == ("bus1", "device1")
        assert caught.value.hint
        rig.faults.silent = False
        assert [r.value for r in await driver.read()] == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


@pytest.mark.parametrize("rig", SHARED, indirect=True)
async def test_silent_device_leaves_its_neighbour_alone(rig: Rig) -> None:
    async with rig.connected() as (bus, driver):
        neighbour = rig.make_neighbour(bus)
        rig.faults.silent = True
        for _ in range(3):
            with pytest.raises(NoAnswer):
                await driver.read()
            assert [r.value for r in await neighbour.read()][1] == pytest.approx(NEIGHBOUR, abs=rig.tolerance)


@pytest.mark.parametrize("rig", SHARED, indirect=True)
async def test_concurrent_reads_on_one_bus_do_not_mix(rig: Rig) -> None:
    async with rig.connected() as (bus, driver):
        neighbour = rig.make_neighbour(bus)
        for _ in range(5):
            mine, theirs = await asyncio.gather(driver.read(), neighbour.read())
            assert mine[1].value == pytest.approx(rig.true_values[1], abs=rig.tolerance * 1.0001)
            assert theirs[1].value == pytest.approx(NEIGHBOUR, abs=rig.tolerance)


@pytest.mark.parametrize("rig", TYPED, indirect=True)
async def test_wrong_sensor_is_refused_at_connect(rig: Rig) -> None:
    rig.spoil_identity()
    with pytest.raises(WrongDevice) as caught:
        async with rig.connected():
            pass
    assert caught.value.channel
    assert caught.value.hint


@pytest.mark.parametrize("rig", TYPED, indirect=True)
async def test_device_that_returns_with_another_sensor_is_refused(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        await driver.read()
        rig.faults.silent = True
        with pytest.raises(NoAnswer):
            await driver.read()
        rig.spoil_identity()
        rig.faults.silent = False
        for _ in range(2):
            with pytest.raises(WrongDevice):
                await driver.read()


async def test_cancelled_read_does_not_spoil_the_next(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        for _ in range(5):
            task = asyncio.ensure_future(driver.read())
            for _ in range(3):
                await asyncio.sleep(0)
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            values = [r.value for r in await driver.read()]
            assert values == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


async def test_reconnects_after_close(rig: Rig) -> None:
    bus = make_bus("bus1", rig.kind, rig.options)
    driver = rig.make(bus)
    for _ in range(2):
        await bus.connect()
        await driver.connect()
        assert len(await driver.read()) == len(rig.true_values)
        await driver.close()
        await bus.close()
    await bus.close()


async def test_read_without_connection_says_so(rig: Rig) -> None:
    with pytest.raises(ConnectError, match="not connected"):
        await rig.make(make_bus("bus1", rig.kind, rig.options)).read()


async def test_wire_that_goes_away_is_told(rig: Rig) -> None:
    async with rig.connected() as (bus, driver):
        await rig.stop_wire()
        for _ in range(3):
            with pytest.raises((ConnectError, NoAnswer)) as caught:
                await driver.read()
        assert isinstance(caught.value, ConnectError)
        await bus.close()
        with pytest.raises(DriverError):
            await bus.connect()
