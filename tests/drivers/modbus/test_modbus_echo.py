"""Two-wire RS-485 adapters that receive what they send: a request is never taken for its own answer."""

import asyncio
from collections.abc import Callable

import pytest

from drivers.base import NoAnswer
from drivers.modbus.frames import find_rtu_answer
from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus, ModbusRtuTcpBus
from drivers.modbus.settings import ModbusRtuSettings, ModbusRtuTcpSettings
from tests.benches.rtu_talk import TIMEOUT_S, TWO, RtuPeer, frame, honest, line
from tests.benches.stream_server import stream_server

pytestmark = pytest.mark.simulated_time

ITS_OWN = Block(2, 0x0300, 17)
"""The request, 01 02 03 00 00 11, is an answer of three bytes: bits 0x000011."""
TRUE_BITS = (1,) + (0,) * 15 + (1,)


def bits(request: bytes) -> bytes:
    """The answer of a device whose bits 0 and 16 are set."""
    count = int.from_bytes(request[4:6], "big")
    data = b"\x01\x00\x01\x00\x00\x00"[: (count + 7) // 8]
    return frame(bytes((request[0], request[1], len(data))) + data)


def echoing(reply: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    return lambda request: request + reply(request)


def test_the_request_is_a_valid_answer_to_itself() -> None:
    """Otherwise the tests below show nothing."""
    request = frame(bytes.fromhex("01 02 03 00 00 11"))
    assert find_rtu_answer(request, 1, ITS_OWN) == bytes.fromhex("02 03 00 00 11")


async def test_registers_are_read_behind_an_echo() -> None:
    async with line() as (bus, peer):
        peer.reply = echoing(honest)
        for _ in range(3):
            assert await bus.read("d", 1, TWO) == (100, 101)
    assert len(peer.requests) == 4, "one for each read, and one of another form, as two equal answers came at once"


async def test_an_echo_is_recognised_before_a_request_that_is_its_own_answer() -> None:
    async with line() as (bus, peer):
        peer.reply = echoing(bits)
        for _ in range(3):
            assert await bus.read("d", 1, ITS_OWN) == TRUE_BITS
    assert len(peer.requests) == 5, "one to see the echo, one for each read, and one as two equal answers came at once"


async def test_a_line_without_echo_is_recognised() -> None:
    async with line() as (bus, peer):
        peer.reply = bits
        for _ in range(3):
            assert await bus.read("d", 1, ITS_OWN) == TRUE_BITS
    assert len(peer.requests) == 5


async def test_without_an_echo_an_answer_that_equals_its_request_is_one() -> None:
    """A device of which bit 16 is set: it answers 01 02 03 00 00 11 to 01 02 03 00 00 11."""

    def answer(request: bytes) -> bytes:
        data = b"\x00\x00\x11\x00\x00\x00"[: (int.from_bytes(request[4:6], "big") + 7) // 8]
        return frame(bytes((request[0], request[1], len(data))) + data)

    async with line() as (bus, peer):
        peer.reply = answer
        for _ in range(3):
            assert await bus.read("d", 1, ITS_OWN) == (0,) * 16 + (1,)
        assert answer(peer.requests[-1]) == peer.requests[-1]


@pytest.mark.parametrize("unset", [None, True])
async def test_an_echo_alone_is_silence(unset: bool | None) -> None:
    """The unit is off: the request itself must not count as bits."""
    peer = RtuPeer()
    path = await peer.port.start()
    bus = ModbusRtuBus("b", ModbusRtuSettings(port=path, baud=115200, timeout_s=TIMEOUT_S, local_echo=unset))
    try:
        await bus.connect()
        peer.reply = echoing(lambda _: b"")
        for _ in range(3):
            with pytest.raises(NoAnswer, match="did not answer"):
                await bus.read("d", 1, ITS_OWN)
        peer.reply = echoing(bits)
        assert await bus.read("d", 1, ITS_OWN) == TRUE_BITS
    finally:
        await bus.close()
        await peer.port.stop()


@pytest.mark.parametrize(("stated", "requests"), [(None, 2), (True, 1)])
async def test_what_is_stated_of_the_echo_need_not_be_found_out(stated: bool | None, requests: int) -> None:
    peer = RtuPeer()
    bus = ModbusRtuBus("b", ModbusRtuSettings(port=await peer.port.start(), timeout_s=TIMEOUT_S, local_echo=stated))
    try:
        await bus.connect()
        peer.reply = echoing(bits)
        assert await bus.read("d", 1, ITS_OWN) == TRUE_BITS
        assert len(peer.requests) == requests
    finally:
        await bus.close()
        await peer.port.stop()


@pytest.mark.parametrize(("stated", "requests"), [(None, 2), (False, 1)])
async def test_the_same_behind_a_device_server(stated: bool | None, requests: int) -> None:
    asked: list[bytes] = []

    async def line_behind(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while request := await reader.read(8):
            asked.append(request)
            writer.write(bits(request))

    async with stream_server(line_behind) as port:
        settings = ModbusRtuTcpSettings(host="127.0.0.1", port=port, timeout_s=TIMEOUT_S, local_echo=stated)
        bus = ModbusRtuTcpBus("b", settings)
        try:
            await bus.connect()
            assert await bus.read("d", 1, ITS_OWN) == TRUE_BITS
            assert len(asked) == requests
        finally:
            await bus.close()
