"""Modbus TCP against a peer that misbehaves: each answer is taken by its number, or not at all."""

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer
from drivers.bus_settings import ModbusTcpSettings
from drivers.modbus_bus import ModbusTcpBus
from drivers.modbus_profile import Block

TWO = Block(3, 0, 2)
GOOD = bytes.fromhex("03 04 00 64 00 65")


def message(number: int, pdu: bytes, *, unit: int = 1, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", number, protocol, len(pdu) + 1, unit) + pdu


@asynccontextmanager
async def host(reply: Callable[[int], bytes]) -> AsyncIterator[ModbusTcpBus]:
    """A host that answers request number n with the bytes reply(n), and a bus connected to it."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while request := await reader.read(100):
                writer.write(reply(int.from_bytes(request[:2], "big")))
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    bus = ModbusTcpBus("bus1", ModbusTcpSettings(host="127.0.0.1", port=port, timeout_s=0.1))
    try:
        await bus.connect()
        yield bus
    finally:
        await bus.close()
        server.close()
        await server.wait_closed()
        await asyncio.sleep(0.01)


async def test_late_answer_is_not_taken_for_the_next() -> None:
    def reply(number: int) -> bytes:
        return b"" if number == 1 else message(1, bytes.fromhex("03 04 00 01 00 01")) + message(number, GOOD)

    async with host(reply) as bus:
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_answer_in_pieces_and_two_at_once() -> None:
    async with host(lambda n: message(n, GOOD)[:4]) as bus:
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
    async with host(lambda n: message(n - 1, GOOD) + message(n, GOOD)) as bus:
        for _ in range(3):
            assert await bus.read("d", 1, TWO) == (100, 101)


@pytest.mark.parametrize(
    ("reply", "error", "text"),
    [
        pytest.param(lambda n: message(n, GOOD, unit=9), BadAnswer, "unit 9 answered", id="another unit"),
        pytest.param(lambda n: message(n, b"\x04" + GOOD[1:]), BadAnswer, "does not fit", id="another function"),
        pytest.param(lambda n: message(n, GOOD[:-2]), BadAnswer, "does not fit", id="too short"),
        pytest.param(lambda n: message(n, GOOD + b"\0"), BadAnswer, "does not fit", id="too long"),
        pytest.param(lambda n: message(n, b"\x83\x0b"), NoAnswer, "gateway target", id="dead unit behind a gateway"),
        pytest.param(lambda n: message(n, GOOD, protocol=5), ConnectError, "not Modbus", id="another protocol"),
        pytest.param(lambda _: b"HTTP/1.1 400 Bad Request\r\n", ConnectError, "not Modbus", id="a web server"),
    ],
)
async def test_what_is_not_our_answer_is_told(
    reply: Callable[[int], bytes], error: type[DriverError], text: str
) -> None:
    async with host(reply) as bus:
        with pytest.raises(error, match=text):
            await bus.read("d", 1, TWO)


async def test_dead_unit_behind_a_gateway_leaves_the_connection_open() -> None:
    async with host(lambda n: message(n, b"\x83\x0b") if n <= 20 else message(n, GOOD)) as bus:
        for _ in range(20):
            with pytest.raises(NoAnswer):
                await bus.read("d", 1, TWO)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_refused_connection_names_host_and_port() -> None:
    server = await asyncio.start_server(lambda _r, _w: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    await server.wait_closed()
    with pytest.raises(ConnectError, match=f"127.0.0.1:{port}"):
        await ModbusTcpBus("b", ModbusTcpSettings(host="127.0.0.1", port=port)).connect()
