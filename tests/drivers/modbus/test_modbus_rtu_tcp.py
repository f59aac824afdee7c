"""Modbus RTU over TCP: the serial line of a device server, which loses the connection and not what is on the line."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from drivers.base import BadAnswer, ConnectError, NoAnswer, Quality, SetupError, SystemClock
from drivers.build import make_device
from drivers.modbus.rtu import ModbusRtuTcpBus, RtuFramedBus
from drivers.modbus.settings import ModbusRtuTcpSettings
from simulators.devices import DeviceServer
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.voltage_input import VoltageInput
from tests.benches.buses import make_bus
from tests.benches.late_answers import Late
from tests.benches.rtu_talk import TIMEOUT_S, TWO, registers

pytestmark = pytest.mark.simulated_time


@asynccontextmanager
async def served(*units: ModbusUnit) -> AsyncIterator[tuple[ModbusRtuTcpBus, DeviceServer]]:
    """A connected bus to the units 1, 2, ..., and their server."""
    server = DeviceServer(dict(enumerate(units, start=1)))
    port = await server.start()
    bus = ModbusRtuTcpBus("bus1", ModbusRtuTcpSettings(host="127.0.0.1", port=port, timeout_s=TIMEOUT_S))
    try:
        await bus.connect()
        yield bus, server
    finally:
        await bus.close()
        await server.stop()


def module(*values_um: float) -> VoltageInput:
    return VoltageInput(lambda: list(values_um), range_um=500.0)


def hang_up(server: DeviceServer) -> None:
    for connection in tuple(server.server.connections):
        connection.abort()


async def test_a_serial_profile_reads_its_device_behind_the_server() -> None:
    values = [5.0, 250.0, 400.0]
    async with served(module(*values)) as (bus, _):
        channels = {f"c{i}": i for i in range(3)}
        driver = make_device("d", bus, "analogue_displacement", 1, channels, {}, SystemClock())
        await driver.connect()
        read = await driver.read()
    assert [r.quality for r in read] == [Quality.GOOD] * 3
    assert [r.value for r in read] == pytest.approx(values, abs=0.025)


async def test_an_answer_that_comes_in_pieces_is_put_together() -> None:
    async with served(module(5.0, 250.0)) as (bus, server):
        whole = await bus.read("d", 1, TWO)
        server.spoil = lambda _, frame: [(0.01 * i, frame[i : i + 1]) for i in range(len(frame))]
        assert await bus.read("d", 1, TWO) == whole


@pytest.mark.parametrize("kind", ["modbus_rtu_tcp", "modbus_rtu"])
async def test_what_follows_a_damaged_piece_soon_is_waited_for(kind: str) -> None:
    """A server sends on in pieces, further apart than a line's own. `socket://` is the same server."""
    server = DeviceServer({1: module(5.0, 250.0)})
    port = await server.start()
    where = {"host": "127.0.0.1", "port": port} if kind == "modbus_rtu_tcp" else {"port": f"socket://127.0.0.1:{port}"}
    bus = make_bus("bus1", kind, {**where, "timeout_s": TIMEOUT_S})
    assert isinstance(bus, RtuFramedBus)
    try:
        await bus.connect()
        whole = await bus.read("d", 1, TWO)
        server.spoil = lambda _, frame: [(0.0, frame[:-1] + bytes((frame[-1] ^ 1,))), (0.06, frame)]
        assert await bus.read("d", 1, TWO) == whole
    finally:
        await bus.close()
        await server.stop()


async def test_a_late_answer_on_a_new_connection_is_not_taken_for_the_next_one() -> None:
    """The old answer is kept by the line, and looks like the new one: same unit, function and length."""
    values = [100.0, 200.0]
    async with served(VoltageInput(lambda: values, range_um=500.0)) as (bus, server):
        old = await bus.read("d", 1, TWO)
        server.spoil = late = Late({1}, takes_s=0.01)
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
        hang_up(server)
        values[:] = [300.0, 400.0]
        late.let_go()
        new = await bus.read("d", 1, TWO)
        assert len(server.server.connections) == 1, "it was opened again"
    assert (old, new) == ((2000, 4000), (6000, 8000))


async def test_a_server_that_closes_after_each_answer_is_opened_for_each_request() -> None:
    async with served(module(5.0, 250.0)) as (bus, server):
        first = await bus.read("d", 1, TWO)
        for _ in range(3):
            hang_up(server)
            assert await bus.read("d", 1, TWO) == first


async def test_a_closed_bus_does_not_open_itself() -> None:
    async with served(module(5.0)) as (bus, server):
        await bus.close()
        with pytest.raises(ConnectError, match="not connected"):
            await bus.read("d", 1, TWO)
        await asyncio.sleep(0.01)
        assert not server.server.connections


async def test_the_echo_of_the_servers_line_is_skipped() -> None:
    async with served(module(5.0, 250.0)) as (bus, server):
        whole = await bus.read("d", 1, TWO)
    async with served(module(5.0, 250.0)) as (bus, server):
        request = bytes.fromhex("01 04 00 00 00 02 71 cb")
        server.spoil = lambda _, frame: [(0.0, request + frame)]
        for _ in range(3):
            assert await bus.read("d", 1, TWO) == whole


async def test_modbus_tcp_answers_are_not_rtu_answers() -> None:
    """The server translates: kind = "modbus_tcp" would be right, so its answers are refused."""
    async with served(module(5.0, 250.0)) as (bus, server):
        server.spoil = lambda _, frame: [(0.0, bytes((0, 1, 0, 0, 0, len(frame) - 2)) + frame[:-2])]
        with pytest.raises(BadAnswer, match="no valid answer of unit 1"):
            await bus.read("d", 1, TWO)


async def test_a_damaged_answer_is_refused() -> None:
    async with served(module(5.0, 250.0)) as (bus, server):
        server.spoil = lambda unit, _: [(0.0, registers(unit, 1, 2)[:-1] + b"\x00")]
        with pytest.raises(BadAnswer, match="no valid answer of unit 1"):
            await bus.read("d", 1, TWO)


@pytest.mark.parametrize(
    ("profile", "unit", "code"),
    [
        ("icpdas_m7015", 0, "unit_beyond"),
        ("advantech_adam6015", 1, "profile_misfit"),
    ],
)
def test_what_no_serial_line_has_is_refused(profile: str, unit: int, code: str) -> None:
    bus = make_bus("b", "modbus_rtu_tcp", {"host": "nowhere", "port": 4001})
    with pytest.raises(SetupError) as raised:
        make_device("d", bus, profile, unit, {"a": 0}, {}, SystemClock())
    assert (raised.value.what.code, raised.value.what.values["kind"]) == (code, "modbus_rtu_tcp")
