"""A field problem becomes a test: a recording of a faulty wire, played back, is read with the same outcome."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.base import DriverError, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.micro_epsilon.ethernet import find_block
from gateway.acquisition.build import lines_of
from gateway.acquisition.wire_log import WireLog, WireLogWriter, read_wire_log
from gateway.config.file import parse
from gateway.config.wires import wires_toml
from gateway.demo.play import play_bus, read_wire_recording
from gateway.runtime.clocks import RealClock
from simulators.devices import M7015, Adam6015, Cia404Node, DeviceServer, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.me_controller import MeController
from simulators.devices.source import SensorFault
from simulators.devices.spoil import Spoil
from tests.benches.buses import make_bus
from tests.benches.free_port import free_port

pytestmark = pytest.mark.simulated_time

TIMEOUT_S = 0.3
BEGAN = datetime(2026, 11, 23, 8, tzinfo=UTC)


def counting(channels: int) -> Callable[[], list[float]]:
    """Another value at each read, so that no answer can stand in for another."""
    turn = 0

    def source() -> list[float]:
        nonlocal turn
        turn += 1
        return [20.0 + turn % 30 + channel / 10 for channel in range(channels)]

    return source


@dataclass
class DeviceOnWire:
    """A device on its wire, with what is to happen before each read."""

    kind: str
    options: dict[str, object]
    profile: str
    unit: int
    stop: Callable[[], Awaitable[None]]
    steps: Sequence[Callable[[], None]]
    device_options: Mapping[str, object] = field(default_factory=dict)


def nothing() -> None:
    """A read without a fault."""


async def rtu(*, over_tcp: bool = False) -> DeviceOnWire:
    module = M7015(counting(6))
    line = DeviceServer({3: module}) if over_tcp else RtuLine({3: module})
    where = await line.start()
    options: dict[str, object] = {"host": "127.0.0.1", "port": where} if over_tcp else {"port": where, "baud": 115200}

    def spoil(how: Spoil | None) -> Callable[[], None]:
        return lambda: setattr(line, "spoil", how)

    def late(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(1.3 * TIMEOUT_S, frame)]

    def garbled(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, frame[:4] + b"\x55" + frame[5:])]

    def broken() -> None:
        module.faults.set(1, SensorFault.OPEN)

    def silent() -> None:
        module.faults.silent = True

    def back() -> None:
        module.faults.silent = False

    spoilt = (spoil(garbled), spoil(None), spoil(late), spoil(None))
    steps = (nothing, broken, *spoilt, nothing, silent, nothing, back, nothing)
    return DeviceOnWire("modbus_rtu_tcp" if over_tcp else "modbus_rtu", options, "icpdas_m7015", 3, line.stop, steps)


async def rtu_over_tcp() -> DeviceOnWire:
    return await rtu(over_tcp=True)


async def tcp() -> DeviceOnWire:
    module = Adam6015(counting(7))
    host = TcpHost({1: module})
    port = await host.start()

    def late(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(1.3 * TIMEOUT_S, frame)]

    def in_pieces(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, frame[:3]), (0.01, frame[3:11]), (0.02, frame[11:])]

    def foreign(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, b"\x00\x07\x00\x00\x00\x03\x01\x83\x02" + frame)]

    def spoil(how: Spoil | None) -> Callable[[], None]:
        return lambda: setattr(host, "spoil", how)

    def broken() -> None:
        module.faults.set(6, SensorFault.OPEN)

    steps = (nothing, broken, spoil(late), spoil(None), nothing, spoil(in_pieces), spoil(foreign), spoil(None))
    return DeviceOnWire("modbus_tcp", {"host": "127.0.0.1", "port": port}, "advantech_adam6015", 1, host.stop, steps)


async def tcp_hanging_up() -> DeviceOnWire:
    """The device closes the connection at the third read, and does not come back before the end."""
    module = Adam6015(counting(7))
    host = TcpHost({1: module})
    port = await host.start()

    def hang_up(_: int, __: bytes) -> list[tuple[float, bytes]]:
        for connection in tuple(host.server.connections):
            connection.abort()
        return []

    def spoil() -> None:
        host.spoil = hang_up

    return DeviceOnWire(
        "modbus_tcp", {"host": "127.0.0.1", "port": port}, "advantech_adam6015", 1, host.stop, (nothing, nothing, spoil)
    )


async def canopen(transfer: str = "sdo") -> DeviceOnWire:
    node = Cia404Node(5, counting(4), inputs=4)
    adapter = SlcanAdapter([node])
    path = await adapter.start()

    def broken() -> None:
        node.faults.set(0, SensorFault.OPEN)

    def silent() -> None:
        node.faults.silent = True

    def back() -> None:
        node.faults.silent = False

    options: dict[str, object] = {"interface": "slcan", "channel": path}
    steps = (nothing, broken, nothing, silent, back, nothing, nothing)
    return DeviceOnWire("canopen", options, "cia404", 5, adapter.stop, steps, {"vendor": "jumo", "transfer": transfer})


async def canopen_by_sync() -> DeviceOnWire:
    return await canopen("sync")


async def me_rs485() -> DeviceOnWire:
    sensor = MeSensor(counting(1), range_um=500.0)
    path = await sensor.start()

    def lost_target() -> None:
        sensor.faults.set(0, SensorFault.OPEN)

    def silent() -> None:
        sensor.faults.silent = True

    def back() -> None:
        sensor.faults.silent = False
        sensor.faults.set(0, None)

    steps = (nothing, lost_target, silent, back, nothing)
    return DeviceOnWire("me_rs485", {"port": path}, "me_rs485", 126, sensor.stop, steps, {"range_um": 500.0})


WIRES: dict[str, Callable[[], Awaitable[DeviceOnWire]]] = {
    "rtu": rtu,
    "rtu over tcp": rtu_over_tcp,
    "tcp": tcp,
    "tcp hanging up": tcp_hanging_up,
    "canopen": canopen,
    "canopen by SYNC": canopen_by_sync,
    "me_rs485": me_rs485,
}


async def outcomes(
    wire: DeviceOnWire,
    options: Mapping[str, object],
    steps: Sequence[Callable[[], None]],
    log: WireLogWriter | None = None,
) -> list[object]:
    """What a driver reports for each read: values with quality and text, or the error in full."""
    tap = None if log is None else log.tap("bus1")
    there = {field: value for field, value in options.items() if value is not None}
    bus = make_bus("bus1", wire.kind, {**there, "timeout_s": TIMEOUT_S}, tap)
    channels = {"first": 0} if wire.kind == "me_rs485" else {"first": 0, "second": 1}
    driver = make_device("device1", bus, wire.profile, wire.unit, channels, wire.device_options, SystemClock())
    told: list[object] = []
    try:
        await bus.connect()
        await driver.connect()
        for step in steps:
            step()
            try:
                told.append([(r.channel, repr(r.value), r.quality, r.detail) for r in await driver.read()])
            except DriverError as error:
                told.append((type(error), str(error)))
    finally:
        await driver.close()
        await bus.close()
    return told


@asynccontextmanager
async def recorded(wire: DeviceOnWire, path: Path) -> AsyncIterator[tuple[list[object], WireLog]]:
    with WireLogWriter(path, "", BEGAN, most_bytes=10**6) as log:
        told = await outcomes(wire, wire.options, wire.steps, log)
    await wire.stop()
    yield told, read_wire_log(path)


@pytest.mark.parametrize("name", WIRES)
async def test_playback_is_read_as_the_device_was(name: str, tmp_path: Path) -> None:
    wire = await WIRES[name]()
    async with recorded(wire, tmp_path / "field.wire") as (told, log):
        assert len({str(outcome) for outcome in told}) > 2  # something happened
        played = await play_bus("bus1", wire.kind, log.of("bus1"), tmp_path)
        try:
            again = await outcomes(wire, played.place, [nothing] * len(told))
        finally:
            await played.stops.stop()
    assert again == told
    assert played.script.unknown == 0


async def test_can_on_a_multicast_group_is_read_as_the_node_was(tmp_path: Path) -> None:
    wire = await canopen()
    async with recorded(wire, tmp_path / "field.wire") as (told, log):
        played = await play_bus("bus1", wire.kind, log.of("bus1"), tmp_path, ("239.74.163.11", free_port()))
        try:
            again = await outcomes(wire, played.place, [nothing] * len(told))
        finally:
            await played.stops.stop()
    assert played.place["interface"] == "udp_multicast"
    assert again == told
    assert played.script.unknown == 0


async def test_after_the_last_answer_the_first_comes_again(tmp_path: Path) -> None:
    wire = await me_rs485()
    wire.steps = (nothing, nothing, nothing)
    async with recorded(wire, tmp_path / "field.wire") as (told, log):
        played = await play_bus("bus1", wire.kind, log.of("bus1"), tmp_path)
        try:
            again = await outcomes(wire, played.place, [nothing] * 7)
        finally:
            await played.stops.stop()
    assert again == told + again[3:4] + told  # connect reads once, too
    assert again[3] not in told


async def test_stream_that_nobody_asks_for_is_played_in_time(tmp_path: Path) -> None:
    controller = MeController(counting(2), range_um=500.0, rate_hz=50)
    options = {"host": "127.0.0.1", "port": await controller.start()}
    wire = DeviceOnWire("me_ethernet", options, "me_ethernet", 1, controller.stop, [nothing] * 8, {"range_um": 500.0})
    async with recorded(wire, tmp_path / "field.wire") as (_, log):
        played = await play_bus("bus1", wire.kind, log.of("bus1"), tmp_path)
        try:
            again = await outcomes(wire, played.place, [nothing] * 4)
        finally:
            await played.stops.stop()
    blocks = [find_block(event.data) for event in log.of("bus1") if event.passed == "received"]
    sent = {block.values[0] / 0xFFFFFF * 500.0 for block in blocks if block is not None}
    assert len(sent) >= 8
    assert all(isinstance(outcome, list) and float(outcome[0][1]) in sent for outcome in again)
    assert len({str(outcome) for outcome in again}) > 1


async def test_example_of_the_documents_is_read_as_it_says(tmp_path: Path) -> None:
    config, events = read_wire_recording(Path("docs/example.wire"), tmp_path)
    assert config is not None
    played = [
        await play_bus(bus.name, bus.kind, [event for event in events if event.bus == bus.name], tmp_path)
        for bus in config.buses
    ]
    there = parse(wires_toml(config, {one.bus: one.place for one in played}), tmp_path / "gateway.toml")
    assert there.input_names == config.input_names
    readings: list[Reading] = []
    try:
        for line in lines_of(there, RealClock()):
            await line.bus.connect()
            for driver in line.drivers:
                await driver.connect()
                readings += await driver.read()
            await line.bus.close()
    finally:
        for one in played:
            await one.stops.stop()
    assert len(readings) == 30
    assert [r.channel for r in readings if r.quality is not Quality.GOOD] == ["bed_rear_left"]
    values = {reading.channel: reading.value for reading in readings}
    assert values["bed_front_left"] == pytest.approx(0x00EA / 10)  # the first answer of unit 1
    assert values["spindle_growth"] == pytest.approx(249.94913, abs=1e-4)
