"""Scanning hosts: units behind one port, devices that ignore the unit id, controllers that stream."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.base import SetupError
from gateway.commissioning.scan.found import ScanReport
from gateway.commissioning.scan.fragment import merged
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts
from gateway.config.file import load
from simulators.devices import M7015, Adam6015, DeviceServer, TcpHost
from simulators.devices.me_controller import MeController
from simulators.devices.modbus_unit import ModbusUnit, answer
from simulators.devices.wago464 import Wago464
from simulators.devices.wago_coupler import WagoCoupler
from tests.benches.buggy_library import BuggyDecoder
from tests.benches.free_port import free_port
from tests.benches.refusals import refusing
from tests.benches.started import started

pytestmark = pytest.mark.simulated_time

SEVEN = [20.0, 21.0, 22.0, 23.0, 24.0, 25.0, 26.0]


def host(units: Mapping[int, ModbusUnit]) -> AbstractAsyncContextManager[int]:
    return started(TcpHost(units))


@pytest.mark.parametrize(
    ("where", "timeout_s", "rtu", "field"),
    [
        (("http://adam", None), 1.0, False, "host: host_form value='http://adam'"),
        (("127.0.0.1", 65536), 1.0, False, "port: expected value=65536 at_most"),
        (("127.0.0.1", 502), 61.0, False, "timeout_s: expected at_most"),
        (("127.0.0.1", None), 1.0, True, "port: missing_no_default"),
    ],
)
async def test_a_place_with_which_no_bus_could_be_is_refused_before_any_is_asked(
    where: tuple[str, int | None], timeout_s: float, rtu: bool, field: str
) -> None:
    asked: list[str] = []
    what = TcpScan((("127.0.0.1", free_port()), where), (1,), timeout_s, rtu)
    with refusing(SetupError, field):
        await scan_hosts(what, lambda _, text: asked.append(text), lambda: False)
    assert asked == []


async def scan(*ports: int, units: range = range(1, 4)) -> ScanReport:
    hosts = tuple(("127.0.0.1", port) for port in ports)
    return await scan_hosts(TcpScan(hosts, units, timeout_s=0.3), lambda *_: None, lambda: False)


async def test_units_behind_one_host_are_recognised() -> None:
    image = WagoCoupler([Wago464(lambda: SEVEN[:4])], modules=(0x8401, 464))
    async with host({1: Adam6015(lambda: SEVEN), 3: image}) as port:
        report = await scan(port)
    (place,) = report.places
    assert [(d.unit, d.what.profile) for d in place.devices] == [(1, "advantech_adam6015"), (3, "wago_750_464")]
    assert place.devices[0].reads == "20.00 21.00 22.00 23.00 24.00 25.00 26.00 degC"
    assert place.devices[1].what.doubts == ()  # digital modules stand behind the analogue ones in the image
    assert report.remarks == []


async def test_module_behind_another_analogue_one_is_doubtful() -> None:
    image = WagoCoupler([Wago464(lambda: SEVEN[:4], start=4)], modules=(467, 464, 464))
    async with host({1: image}) as port:
        (device,) = (await scan(port)).found
    assert device.what.doubts == (
        "address_offset: add up the words of 750-467, which precede the 750-464",
        "the coupler has 2 modules 750-464; this is the first",
    )


async def test_coupler_without_a_known_module_says_what_it_has() -> None:
    async with host({1: WagoCoupler([], modules=(467, 0x8202))}) as port:
        (device,) = (await scan(port)).found
    assert device.what.profile == ""
    assert device.what.evidence == "WAGO coupler 750-352 without 750-464; analogue modules: 750-467"


async def test_host_that_ignores_the_unit_id_is_one_device() -> None:
    adam = Adam6015(lambda: SEVEN)
    async with host(dict.fromkeys(range(256), adam)) as port:
        report = await scan(port)
    assert [device.unit for device in report.found] == [1]
    assert report.remarks == [f"127.0.0.1:{port} answers to every unit id: one device, shown as unit 1"]


@pytest.mark.slow
@pytest.mark.parametrize("refuses_itself", [False, True])
async def test_host_that_refuses_unknown_units_is_asked_for_all(refuses_itself: bool) -> None:
    """As pymodbus' server does, with exception 4. A unit that refuses what is asked for does so in another way."""
    first = 100 if refuses_itself else 0
    device = SimDevice(247, SimData(first, count=8, values=230, datatype=DataType.UINT16))
    port = free_port()
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    try:
        report = await scan(port, units=range(1, 248))
    finally:
        await server.shutdown()  # type: ignore[no-untyped-call]
    assert [device.unit for device in report.found] == [247]
    assert report.remarks == []


@dataclass(frozen=True)
class OnlyFunction:
    """A unit that has the addresses 0 and 1 of one function and refuses all others; with function 0 it refuses
    everything."""

    function: int
    silent: bool = False

    def memory(self, function: int) -> Mapping[int, int]:
        return {0: 1, 1: 1} if function == self.function else {}


async def test_units_are_distinguished_by_what_they_do_not_refuse() -> None:
    """The host refuses every unknown id with the same exception as an unknown address."""
    units: dict[int, ModbusUnit] = dict.fromkeys(range(256), OnlyFunction(0))
    units |= {unit: OnlyFunction(function) for unit, function in ((2, 4), (5, 2), (7, 1), (9, 3))}
    async with host(units) as port:
        report = await scan(port, units=range(1, 12))
    assert [device.unit for device in report.found] == [2, 5, 7, 9]
    assert report.remarks == []


async def test_controller_that_streams_is_distinguished_from_modbus() -> None:
    async with started(MeController(lambda: [100.0, 200.0], range_um=500.0)) as port:
        report = await scan(port)
    (place,) = report.places
    assert place.kind == "me_ethernet"
    assert place.devices[0].what.evidence == "order number 2303021, serial number 1001"
    assert place.devices[0].reads == "100.00 200.00 µm"


async def test_dead_host_gives_a_remark_and_the_next_one_is_asked() -> None:
    async with host({1: Adam6015(lambda: SEVEN)}) as gone:
        pass
    async with host({2: Adam6015(lambda: SEVEN)}) as port:
        report = await scan(gone, port)
    assert [device.unit for device in report.found] == [2]
    assert any(f"cannot connect to 127.0.0.1:{gone}" in remark for remark in report.remarks)


Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def peer(serve: Serve) -> AsyncIterator[int]:
    """A server that the test plays; every connection is over at the end."""
    connections: set[asyncio.Task[None]] = set()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if (task := asyncio.current_task()) is not None:
            connections.add(task)
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            await serve(reader, writer)
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()

    server = await asyncio.start_server(connected, "127.0.0.1", 0)
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        server.close()
        await asyncio.gather(*connections)
        await server.wait_closed()


async def test_host_that_closes_on_unknown_units_is_asked_again() -> None:
    """Unit 3 is a module; on any other the connection is closed, as some gateways do."""
    adam = Adam6015(lambda: SEVEN)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while (request := await reader.readexactly(12))[6] == 3:
            reply = answer(adam, request[7:])
            writer.write(request[:4] + (len(reply) + 1).to_bytes(2, "big") + request[6:7] + reply)

    async with peer(serve) as port:
        report = await scan(port)
    assert [(device.unit, device.what.profile) for device in report.found] == [(3, "advantech_adam6015")]


async def test_host_with_another_protocol_is_left_alone_soon() -> None:
    connections = 0

    async def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        connections += 1
        writer.write(b"220 mail.example.org ESMTP ready and waiting\r\n" * 3)

    async with peer(greet) as port:
        report = await scan(port, units=range(1, 200))
    assert report.found == []
    assert connections < 10
    assert report.remarks[0].startswith("Modbus: ")


async def test_host_that_accepts_and_never_answers_is_reported() -> None:
    async with started(TcpHost({})) as port:
        report = await scan(port)
    assert report.remarks[0].startswith(f"127.0.0.1:{port} accepts connections, but none of the units")


async def test_units_behind_a_device_server_are_recognised(tmp_path: Path) -> None:
    """Modbus TCP finds nobody there; with RTU frames its modules answer, and the file that follows loads."""
    async with started(DeviceServer({2: M7015(lambda: SEVEN[:6])})) as port:
        assert (await scan(port)).found == []
        there = TcpScan((("127.0.0.1", port),), range(1, 4), timeout_s=0.3, rtu=True)
        report = await scan_hosts(there, lambda *_: None, lambda: False)
    assert [(d.unit, d.what.profile) for d in report.found] == [(2, "icpdas_m7015")]
    file = tmp_path / "gateway.toml"
    file.write_text(merged("", report.places, file), encoding="utf-8")
    (bus,) = load(file).buses
    assert (bus.kind, bus.place) == ("modbus_rtu_tcp", f"127.0.0.1:{port}")


async def test_what_was_found_becomes_one_file_and_is_not_added_twice() -> None:
    path = Path("gateway.toml")
    async with host({1: Adam6015(lambda: SEVEN)}) as one, host({5: Adam6015(lambda: SEVEN)}) as two:
        first, second = await scan(one), await scan(two, units=range(5, 6))
    text = merged("", first.places, path)
    both = merged(text, second.places, path)
    assert both.startswith(text.rstrip("\n"))
    assert both.count("[[device]]") == both.count("[[bus]]") == 2
    assert merged(both, [*first.places, *second.places], path) == both


@pytest.mark.simulated_time
async def test_a_bug_in_the_library_is_a_remark_and_the_other_hosts_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    bug = BuggyDecoder(monkeypatch, failures=1)
    async with host({1: Adam6015(lambda: SEVEN)}) as first, host({1: Adam6015(lambda: SEVEN)}) as second:
        report = await scan(first, second)
    assert bug.failures == 0
    assert [place.options["port"] for place in report.places] == [second]
    assert "Modbus: unexpected KeyError in the request to unit 1: 'no such key'" in report.remarks[0]
