"""Modbus TCP against a misbehaving peer: each answer is matched by its number, or rejected."""

import asyncio
import struct
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AsyncExitStack, asynccontextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused
from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.frames import find_tcp_answer
from drivers.modbus.numbers import Block
from drivers.modbus.settings import ModbusTcpSettings
from tests.benches.modbus_host import modbus_host

pytestmark = pytest.mark.simulated_time

TWO = Block(3, 0, 2)
GOOD = bytes.fromhex("03 04 00 64 00 65")


def message(number: int, pdu: bytes, *, unit: int = 1, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", number, protocol, len(pdu) + 1, unit) + pdu


@asynccontextmanager
async def host(reply: Callable[[int], bytes], timeout_s: float = 0.1) -> AsyncIterator[ModbusTcpBus]:
    """A host that answers request number n with the bytes reply(n), and a bus connected to it."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while request := await reader.read(100):
                writer.write(reply(int.from_bytes(request[:2], "big")))
        finally:
            writer.close()

    async with modbus_host(serve, timeout_s) as bus:
        yield bus


async def test_late_answer_is_not_taken_for_the_next() -> None:
    def reply(number: int) -> bytes:
        return b"" if number == 1 else message(1, bytes.fromhex("03 04 00 01 00 01")) + message(number, GOOD)

    async with host(reply) as bus:
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_answer_in_pieces_and_two_at_once() -> None:
    async with host(lambda n: message(n, GOOD)[:4]) as bus:
        with pytest.raises(BadAnswer, match="not a complete Modbus TCP answer"):
            await bus.read("d", 1, TWO)
    async with host(lambda n: message(n - 1, GOOD) + message(n, GOOD)) as bus:
        for _ in range(3):
            assert await bus.read("d", 1, TWO) == (100, 101)


@pytest.mark.parametrize(
    ("reply", "error", "text"),
    [
        pytest.param(lambda n: message(n, GOOD, unit=9), BadAnswer, "ask it as unit 9", id="another unit"),
        pytest.param(
            lambda _: message(0, GOOD), NoAnswer, r"only answers to other requests came \(0\)", id="no number"
        ),
        pytest.param(lambda n: message(n, b"\x84\x02"), Refused, "exception 2", id="another function's exception"),
        pytest.param(lambda n: message(n, b"\x04" + GOOD[1:]), BadAnswer, "does not fit", id="another function"),
        pytest.param(lambda n: message(n, GOOD[:-2]), BadAnswer, "does not fit", id="too short"),
        pytest.param(lambda n: message(n, GOOD + b"\0"), BadAnswer, "does not fit", id="too long"),
        pytest.param(lambda n: message(n, b"\x83\x0b"), NoAnswer, "gateway target", id="dead unit behind a gateway"),
        pytest.param(
            lambda n: message(n, GOOD, protocol=5), BadAnswer, "states protocol 5, not 0", id="another protocol"
        ),
        pytest.param(lambda n: message(n, GOOD)[:5] + b"\xff" + bytes(9), BadAnswer, "states 255 bytes", id="too long"),
        pytest.param(lambda _: b"HTTP/1.1 400 Bad Request\r\n", BadAnswer, "states protocol 21584", id="a web server"),
    ],
)
async def test_what_is_not_our_answer_is_reported(
    reply: Callable[[int], bytes], error: type[DriverError], text: str
) -> None:
    async with host(reply) as bus:
        with pytest.raises(error, match=text):
            await bus.read("d", 1, TWO)


async def test_half_an_answer_costs_only_its_sender() -> None:
    async with host(lambda n: message(n, GOOD)[:-1] if n // 2 % 2 == 0 else message(n, GOOD)) as bus:
        for _ in range(3):
            with pytest.raises(BadAnswer):
                await bus.read("d", 1, TWO)
            assert await bus.read("d", 1, TWO) == (100, 101)


async def test_rest_of_an_answer_that_comes_after_the_timeout_is_ignored() -> None:
    def reply(number: int) -> bytes:
        return message(1, GOOD)[:9] if number == 1 else message(1, GOOD)[9:] + message(number, GOOD)

    async with host(reply) as bus:
        with pytest.raises(BadAnswer):
            await bus.read("d", 1, TWO)
        assert await bus.read("d", 1, TWO) == (100, 101)


Pieces = Iterable[tuple[float, bytes]]
"""What is sent, and how long after what was sent before, s."""


@asynccontextmanager
async def slow_host(reply: Callable[[int, int], Pieces]) -> AsyncIterator[ModbusTcpBus]:
    """It sends reply(number, unit) in pieces. Its units 1 to 3 have been quick, so the bus waits 50 ms for them."""
    known = False

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while request := await reader.read(12):
            number, unit = int.from_bytes(request[:2], "big"), request[6]
            for wait_s, piece in reply(number, unit) if known else [(0.0, message(number, GOOD, unit=unit))]:
                await asyncio.sleep(wait_s)
                writer.write(piece)

    async with modbus_host(serve, 0.5) as bus:
        for unit in (1, 2, 3) * 5:
            await bus.read("d", unit, TWO)
        known = True
        yield bus


async def test_an_answer_that_has_begun_is_waited_for() -> None:
    def reply(number: int, unit: int) -> Pieces:
        answer = message(number, GOOD, unit=unit)
        return [(0.03, answer[at : at + 4]) for at in range(0, len(answer), 4)]

    async with slow_host(reply) as bus:
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_the_next_unit_has_its_full_time_while_a_gateway_may_wait_for_a_silent_one() -> None:
    """The gateway waits 0.3 s for unit 1, and then asks unit 2."""
    async with slow_host(lambda n, unit: [(0.3, b"")] if unit == 1 else [(0.0, message(n, GOOD, unit=2))]) as bus:
        with pytest.raises(NoAnswer, match=r"within 0\.05 s"):
            await bus.read("d", 1, TWO)
        assert await bus.read("d", 2, TWO) == (100, 101)


async def test_only_one_unit_of_a_silent_host_has_its_full_time() -> None:
    async with slow_host(lambda _n, _unit: []) as bus:
        for unit, waited in ((1, "0.05"), (2, "0.5"), (3, "0.05")):
            with pytest.raises(NoAnswer, match=f"unit {unit} did not answer within {waited} s"):
                await bus.read("d", unit, TWO)


async def test_dead_unit_behind_a_gateway_leaves_the_connection_open() -> None:
    async with host(lambda n: message(n, b"\x83\x0b") if n < 40 else message(n, GOOD)) as bus:
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


WORDS = st.tuples(st.integers(0, 65535), st.integers(0, 65535))


def registers(*words: int) -> bytes:
    return bytes((3, 2 * len(words))) + struct.pack(f">{len(words)}H", *words)


PIECES = st.lists(
    st.one_of(
        st.binary(max_size=20),
        st.builds(message, st.integers(0, 65535), st.binary(min_size=1, max_size=20), unit=st.integers(0, 255)),
        st.builds(message, st.integers(0, 4), WORDS.map(lambda words: registers(*words))),
        st.builds(lambda size: struct.pack(">HHHB", 1, 0, size, 1), st.integers(0, 300)),
    ),
    max_size=6,
).map(b"".join)
"""What may stand on the wire: noise, messages of any number, beginnings of messages."""


@given(PIECES, st.integers(1, 4))
def test_answer_that_is_taken_stands_in_the_bytes_whole(heard: bytes, number: int) -> None:
    found = find_tcp_answer(heard, number)
    if found is not None:
        unit, answer = found
        assert message(number, answer, unit=unit) in heard


@given(before=st.binary(max_size=60), after=st.binary(max_size=60), words=WORDS)
def test_answer_is_found_behind_noise(before: bytes, after: bytes, words: tuple[int, int]) -> None:
    """Also behind the beginning of a message with the same number."""
    number = 0xA55A
    beginning = struct.pack(">HHHB", number, 0, 200, 1)
    heard = before + beginning + message(number, registers(*words)) + after
    assert find_tcp_answer(heard, number) == (1, registers(*words))


def test_no_message_is_longer_than_modbus_tcp_allows() -> None:
    """253 bytes of function code and data; 254 of them are noise that looks like a header."""
    longest, longer = (struct.pack(">HHHB", 7, 0, n + 1, 1) + bytes([3]) * n for n in (253, 254))
    assert find_tcp_answer(longest, 7) == (1, bytes([3]) * 253)
    assert find_tcp_answer(longer, 7) is None


def test_any_bytes_before_an_answer_give_it_or_an_error_and_the_next_is_right() -> None:
    """Over loopback: no crash, no hang, no value that was never sent, and no loss of synchronisation."""
    noise, spoilt = b"", True

    def reply(number: int) -> bytes:
        return (noise if spoilt else b"") + message(number, GOOD)

    with asyncio.Runner() as runner:
        stack = AsyncExitStack()
        bus = runner.run(stack.enter_async_context(host(reply, timeout_s=0.02)))

        async def ask() -> None:
            nonlocal spoilt
            spoilt = True
            try:
                taken = await bus.read("d", 1, TWO)
                assert taken == (100, 101) or registers(*taken) in noise
            except DriverError:
                await bus.connect()
            spoilt = False
            for _ in range(10):
                try:
                    taken = await bus.read("d", 1, TWO)
                    break
                except NoAnswer:  # within so short a timeout a busy computer may not get round to it
                    continue
            assert taken == (100, 101)

        @settings(max_examples=150)
        @given(PIECES)
        def any_noise(heard: bytes) -> None:
            nonlocal noise
            noise = heard
            runner.run(ask())

        any_noise()
        runner.run(stack.aclose())
