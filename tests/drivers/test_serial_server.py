"""Serial ports of a device server: Debian's ser2net, by RFC 2217 and by raw TCP, in front of an emulated line."""

import asyncio
import os
import shutil
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest

from drivers.base import ConnectError, NoAnswer, SystemClock
from drivers.build import make_device
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block
from simulators.devices import MeSensor, RtuLine
from simulators.devices.me_sensor import MeLine
from simulators.devices.modbus_servers import crc16
from simulators.devices.voltage_input import VoltageInput
from tests.benches.buses import make_bus
from tests.benches.foreign_server import RestartableServer
from tests.benches.free_port import free_port
from tests.benches.stream_server import stream_server
from tests.benches.waits import until

# ser2net, Debian's device server, for tests with marker `peer`: it puts one serial port on the network.


_CONFIG = """%YAML 1.1
---
connection: &line
  accepter: {accepter},tcp,127.0.0.1,{port}
  connector: serialdev,{device},1200n81,local
  options:
    kickolduser: {newest_wins}
"""


class Ser2net(RestartableServer):
    """A device server on loopback; it can be stopped and started again on its port.

    Parameters
    ----------
    folder: for its files
    device: the serial port, opened at 1200 baud unless the client says otherwise
    scheme: `rfc2217`, or `socket` for raw TCP
    newest_wins: a new client takes the port from the one before; otherwise it is refused
    """

    def __init__(self, folder: Path, device: str, scheme: str, *, newest_wins: bool = True) -> None:
        program = shutil.which("ser2net", path="/usr/sbin:/usr/bin")
        assert program is not None, "ser2net is missing: install Debian's ser2net"
        port = free_port()
        config = folder / "ser2net.yaml"
        accepter = "telnet(rfc2217)" if scheme == "rfc2217" else ""
        wins = str(newest_wins).lower()
        text = _CONFIG.format(accepter=accepter, port=port, device=device, newest_wins=wins)
        config.write_text(text.replace(" ,tcp", " tcp"))
        super().__init__([program, "-n", "-u", "-d", "-c", str(config)], port, folder / "ser2net.log")
        self.url = f"{scheme}://127.0.0.1:{port}"


@contextmanager
def ser2net(folder: Path, device: str, scheme: str, *, newest_wins: bool = True) -> Iterator[Ser2net]:
    """A server that runs."""
    server = Ser2net(folder, device, scheme, newest_wins=newest_wins)
    with server.running():
        yield server


TIMEOUT_S = 60.0
"""A busy computer may need this long for another program's answer."""
LIMIT_S = 60.0
REQUEST_BYTES = 8
VALUES_UM = [5.0, -0.05, 400.0]
THREE, WORDS = Block(4, 0, 3), (100, 0xFFFF, 8000)
"""These numbers contain Telnet's byte 255 twice."""
LOOPBACKS = [("127.0.0.1", "127.0.0.1"), ("::1", "[::1]")]
"""The loopback as a server listens on it, and as a URL names it."""


@asynccontextmanager
async def served(
    folder: Path, scheme: str, *, line_baud: int, baud: int, timeout_s: float = TIMEOUT_S
) -> AsyncIterator[tuple[ModbusBus, Ser2net, RtuLine]]:
    """A connected bus at `baud`, and the server of the line, whose unit understands only `line_baud`."""
    line = RtuLine({1: VoltageInput(lambda: VALUES_UM, range_um=500.0)}, baud=line_baud)
    path = await line.start()
    try:
        with ser2net(folder, path, scheme) as server:
            bus = make_bus("bus1", "modbus_rtu", {"port": server.url, "baud": baud, "timeout_s": timeout_s})
            assert isinstance(bus, ModbusBus)
            try:
                await bus.connect()
                yield bus, server, line
            finally:
                await bus.close()
    finally:
        await line.stop()


@pytest.mark.peer
@pytest.mark.parametrize("baud", [19200, 38400])
async def test_rfc_2217_sets_the_speed_of_the_servers_line_and_passes_every_byte(tmp_path: Path, baud: int) -> None:
    async with served(tmp_path, "rfc2217", line_baud=baud, baud=baud) as (bus, _, _):
        assert await bus.read("d", 1, THREE) == WORDS


@pytest.mark.peer
async def test_a_displacement_sensor_is_read_behind_the_server(tmp_path: Path) -> None:
    line = MeLine([MeSensor(lambda: [123.4], range_um=500.0)])
    path = await line.start()
    try:
        with ser2net(tmp_path, path, "rfc2217") as server:
            bus = make_bus("bus1", "me_rs485", {"port": server.url, "timeout_s": TIMEOUT_S})
            await bus.connect()
            driver = make_device("d", bus, "me_rs485", 0x7E, {"growth": 0}, {"range_um": 500.0}, SystemClock())
            await driver.connect()
            (read,) = await driver.read()
            await bus.close()
        assert read.value == pytest.approx(123.4, abs=0.05)
    finally:
        await line.stop()


@pytest.mark.peer
async def test_a_unit_of_another_speed_is_silent_behind_the_server(tmp_path: Path) -> None:
    async with served(tmp_path, "rfc2217", line_baud=19200, baud=9600, timeout_s=0.2) as (bus, _, line):
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, THREE)
        await until(lambda: line.garbage >= REQUEST_BYTES)


@pytest.mark.peer
async def test_raw_tcp_leaves_the_speed_to_the_server(tmp_path: Path) -> None:
    async with served(tmp_path, "socket", line_baud=1200, baud=9600) as (bus, _, _):
        assert await bus.read("d", 1, THREE) == WORDS


@pytest.mark.peer
async def test_a_server_that_went_and_came_back_is_connected_again(tmp_path: Path) -> None:
    async with served(tmp_path, "rfc2217", line_baud=19200, baud=19200) as (bus, server, _):
        server.stop()
        with pytest.raises(ConnectError, match=r"serial port rfc2217://127\.0\.0\.1:[0-9]+ is gone"):
            await bus.read("d", 1, THREE)
        with pytest.raises(ConnectError, match="cannot open serial port rfc2217://"):
            await bus.connect()
        server.start()
        await bus.connect()
        assert await bus.read("d", 1, THREE) == WORDS


def asks_after_s(port: int) -> float | None:
    """The silence after which this computer's kernel asks the server whether it is still there; None: it does not."""
    for line in Path("/proc/net/tcp").read_text("ascii").splitlines()[1:]:
        _, _, remote, _, _, timer, *_ = line.split()
        if remote == f"0100007F:{port:04X}" and timer.startswith("02:"):
            return int(timer[3:], 16) / os.sysconf("SC_CLK_TCK")
    return None


@pytest.mark.peer
@pytest.mark.parametrize("scheme", ["rfc2217", "socket"])
async def test_a_server_that_goes_without_a_word_is_noticed(tmp_path: Path, scheme: str) -> None:
    async with served(tmp_path, scheme, line_baud=1200, baud=1200) as (bus, server, _):
        assert await bus.read("d", 1, THREE) == WORDS
        port = int(server.url.rpartition(":")[2])
        async with asyncio.timeout(LIMIT_S):
            while (silence_s := asks_after_s(port)) is None:  # while an acknowledgement is due it waits for that
                await asyncio.sleep(0.01)
        assert silence_s < 6.0


@pytest.mark.peer
async def test_a_server_of_raw_tcp_is_distinguished_from_one_of_rfc_2217(tmp_path: Path) -> None:
    async with served(tmp_path, "socket", line_baud=1200, baud=1200) as (_, server, _):
        url = server.url.replace("socket:", "rfc2217:")
        bus = make_bus("bus2", "modbus_rtu", {"port": url})
        with pytest.raises(ConnectError, match="cannot open serial port") as caught:
            await bus.connect()
        assert "socket://" in str(caught.value)


async def test_a_port_where_nobody_listens_is_named() -> None:
    bus = make_bus("bus1", "me_rs485", {"port": f"rfc2217://127.0.0.1:{free_port()}"})
    with pytest.raises(ConnectError, match=r"rfc2217://127\.0\.0\.1:\d+: Connection refused"):
        await bus.connect()


@pytest.mark.slow
async def test_another_server_than_one_of_rfc_2217_is_refused() -> None:
    """All at once, because each takes pyserial's three seconds."""

    async def refused(answer: bytes) -> str:
        async def other(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            while await reader.read(100):
                writer.write(answer)

        async with stream_server(other) as port:
            bus = make_bus("bus1", "modbus_rtu", {"port": f"rfc2217://127.0.0.1:{port}"})
            try:
                await bus.connect()
            except ConnectError as error:
                return str(error)
            await bus.close()
            return f"{answer!r} was accepted"

    answers = (
        b"\xff\xf0",  # the end of a subnegotiation that has not begun
        b"\xff\xfa\x2c\xff\xf0",  # a subnegotiation of nothing
        b"\xff\xfb\x63\xff\xfe\x2c",  # an unknown option, and COM port control refused
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
    )
    said = await asyncio.gather(*map(refused, answers))
    assert [text for text in said if "cannot open serial port" not in text] == []


async def test_a_client_that_no_longer_waits_for_the_server_leaves_no_connection() -> None:
    connected, ended = asyncio.Event(), asyncio.Event()

    async def silent(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        connected.set()
        while await reader.read(100):
            pass
        ended.set()

    async with stream_server(silent) as port:
        bus = make_bus("bus1", "modbus_rtu", {"port": f"rfc2217://127.0.0.1:{port}"})
        opening = asyncio.ensure_future(bus.connect())
        await connected.wait()
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        await ended.wait()
        await bus.close()


@pytest.mark.peer
async def test_a_port_that_opens_when_nobody_waits_any_more_is_closed(tmp_path: Path) -> None:
    """The server gives a port to one client at a time, and refuses others."""
    line = RtuLine({1: VoltageInput(lambda: VALUES_UM, range_um=500.0)}, baud=19200)
    path = await line.start()
    try:
        with ser2net(tmp_path, path, "rfc2217", newest_wins=False) as server:
            bus = make_bus("bus1", "modbus_rtu", {"port": server.url, "baud": 19200, "timeout_s": TIMEOUT_S})
            assert isinstance(bus, ModbusBus)
            opening = asyncio.ensure_future(bus.connect())
            for _ in range(3):  # the thread that opens it is at work
                await asyncio.sleep(0)
            opening.cancel()
            with pytest.raises(asyncio.CancelledError):
                await opening
            async with asyncio.timeout(LIMIT_S):
                while True:
                    try:
                        await bus.connect()
                        break
                    except ConnectError:
                        await asyncio.sleep(0.05)
            assert await bus.read("d", 1, THREE) == WORDS
            await bus.close()
    finally:
        await line.stop()


IAC, WILL, DO, SB, SE, COM_PORT = 255, 251, 253, 250, 240, 44
"""Telnet (RFC 854) and the option of RFC 2217."""
SET_BAUD, SET_DATA, SET_PARITY, SET_STOP = 1, 2, 3, 4


def telnet_commands(data: bytes) -> Iterator[bytes]:
    """The commands of Telnet in whole pieces."""
    while data:
        end = data.index(bytes((IAC, SE))) + 2 if data[1] == SB else 3
        yield data[:end]
        data = data[end:]


@pytest.mark.parametrize(
    ("parity", "stopbits", "expected"), [("N", 1, (1, 1)), ("E", 1, (3, 1)), ("O", 1, (2, 1)), ("N", 2, (1, 2))]
)
@pytest.mark.parametrize(("host", "written"), LOOPBACKS)
async def test_rfc_2217_sets_parity_and_stop_bits(
    parity: str, stopbits: int, expected: tuple[int, int], host: str, written: str
) -> None:
    """A server written from the standard: it does what it is asked, and confirms it."""
    told: dict[int, bytes] = {}

    async def server(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1000):
            for command in telnet_commands(data):
                if command[1] == WILL:
                    writer.write(bytes((IAC, DO, command[2])))
                elif command[1] == DO:
                    writer.write(bytes((IAC, WILL, command[2])))
                elif command[1] == SB and command[2] == COM_PORT:
                    told[command[3]] = command[4:-2]
                    writer.write(command[:3] + bytes((command[3] + 100,)) + command[4:])

    async with stream_server(server, host=host) as port:
        options = {"port": f"rfc2217://{written}:{port}", "baud": 19200, "parity": parity, "stopbits": stopbits}
        bus = make_bus("bus1", "modbus_rtu", options)
        await bus.connect()
        await bus.close()
    assert told[SET_BAUD] == (19200).to_bytes(4, "big")
    assert (told[SET_DATA], (told[SET_PARITY][0], told[SET_STOP][0])) == (b"\x08", expected)


async def answer_once(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """A server that closes after each answer; each register contains its address."""
    request = await reader.readexactly(8)
    address, count = request[3], request[5]
    reply = bytes((1, 4, 2 * count)) + b"".join(bytes((0, address + i)) for i in range(count))
    writer.write(reply + crc16(reply))
    await writer.drain()
    writer.close()


@pytest.mark.parametrize(("host", "written"), LOOPBACKS)
async def test_raw_tcp_is_opened_for_each_request_if_the_server_closes_it(host: str, written: str) -> None:
    async with stream_server(answer_once, host=host) as port:
        bus = make_bus("bus1", "modbus_rtu", {"port": f"socket://{written}:{port}", "timeout_s": TIMEOUT_S})
        assert isinstance(bus, ModbusBus)
        await bus.connect()
        assert [await bus.read("d", 1, Block(4, address, 1)) for address in (7, 8, 9)] == [(7,), (8,), (9,)]
        await bus.close()


async def test_a_request_that_a_closing_server_has_missed_is_sent_again() -> None:
    """It was sent before the end of the connection was seen. Both requests are for the same registers, so one answer is
    enough; the next request is different, and what is still due must not be taken for its answer."""
    opened = 0

    async def server(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal opened
        opened += 1
        if opened == 1:
            await reader.readexactly(8)
            writer.close()
        else:
            await answer_once(reader, writer)

    async with stream_server(server) as port:
        bus = make_bus("bus1", "modbus_rtu_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S})
        assert isinstance(bus, ModbusBus)
        await bus.connect()
        assert [await bus.read("d", 1, Block(4, address, 1)) for address in (7, 8, 9)] == [(7,), (8,), (9,)]
        await bus.close()
