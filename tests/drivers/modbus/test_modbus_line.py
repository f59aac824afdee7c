"""Modbus RTU on a bad line: late, foreign, broken and duplicated answers never become a value."""

import asyncio
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused
from drivers.modbus.frames import find_rtu_answer
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.settings import ModbusRtuSettings
from tests.benches.rtu_talk import TIMEOUT_S, TWO, RtuPeer, frame, honest, line, registers

pytestmark = pytest.mark.simulated_time


async def test_request_is_the_standards_example() -> None:
    """MODBUS over serial line: unit 1, function 4, address 0, count 2 has the checksum 71 CB."""
    async with line() as (bus, peer):
        peer.reply = honest
        assert await bus.read("d", 1, TWO) == (100, 101)
    assert peer.requests == [bytes.fromhex("01 04 00 00 00 02 71 CB")]


async def test_late_answer_is_not_taken_for_the_next() -> None:
    async with line() as (bus, peer):
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
        late = [registers(1, 1, 1)]

        def late_first(request: bytes) -> bytes:
            return (late.pop() if late else b"") + honest(request)

        peer.reply = late_first
        assert await bus.read("d", 1, TWO) == (100, 101)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def cancelled(bus: ModbusRtuBus, peer: RtuPeer) -> None:
    """A request to unit 1 that was sent, and is awaited no more."""
    asked = asyncio.ensure_future(bus.read("d", 1, TWO))
    await peer.is_asked.wait()
    asked.cancel()
    with suppress(asyncio.CancelledError):
        await asked


async def test_late_answer_of_a_cancelled_request_is_not_taken_for_the_next() -> None:
    async with line() as (bus, peer):
        await cancelled(bus, peer)
        peer.reply = honest
        following = asyncio.ensure_future(bus.read("d", 1, TWO))
        peer.port.write(registers(1, 1, 1))
        assert await following == (100, 101)


async def test_line_stays_quiet_while_a_cancelled_request_is_answered() -> None:
    async with line() as (bus, peer):
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        await cancelled(bus, peer)
        peer.reply = honest
        assert await bus.read("d", 2, TWO) == (100, 101)
        assert loop.time() - began_s >= TIMEOUT_S, "however long the first request was on its way"


async def test_once_a_cancelled_request_is_answered_the_next_is_sent_without_waiting_for_its_timeout() -> None:
    async with line(timeout_s=10.0) as (bus, peer):
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        await cancelled(bus, peer)
        peer.port.write(registers(1, 1, 1))
        peer.reply = honest
        assert await bus.read("d", 2, TWO) == (100, 101)
        assert loop.time() - began_s < 1.0


@pytest.mark.parametrize(
    ("answers", "took_s"), [pytest.param(2, 0.7, id="slow unit"), pytest.param(1, 0.1, id="lost answer")]
)
async def test_only_if_a_question_and_its_repetition_are_both_answered_the_unit_counts_as_slow(
    answers: int, took_s: float
) -> None:
    """It took 0.2 s at first; then it is silent for the 0.6 s of RFC 6298, and answers 0.1 s after the repetition."""
    async with line(timeout_s=10.0) as (bus, peer):
        loop = asyncio.get_running_loop()

        def answer(request: bytes, many: int, after_s: float) -> bytes:
            loop.call_later(after_s, peer.port.write, many * honest(request))
            return b""

        peer.reply = lambda request: answer(request, 1, 0.2)
        await bus.read("d", 1, TWO)
        peer.reply = lambda _: b""
        with pytest.raises(NoAnswer, match=r"within 0\.6 s"):
            await bus.read("d", 1, TWO)
        peer.reply = lambda request: answer(request, answers, 0.1)
        assert await bus.read("d", 1, TWO, again=True) == (100, 101)
        peer.reply = lambda _: b""
        began_s = loop.time()
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, TWO)
        off_s = took_s - 0.2
        mean_s, deviation_s = 0.2 + off_s / 8, 0.1 + (abs(off_s) - 0.1) / 4
        assert loop.time() - began_s == pytest.approx(mean_s + 4 * deviation_s, abs=0.05)


@pytest.mark.parametrize(
    ("answer", "heard"),
    [
        pytest.param(registers(2, 7, 7), False, id="another unit"),
        pytest.param(frame(bytes.fromhex("01 03 04 00 07 00 07")), True, id="another function"),
        pytest.param(registers(1, 7), True, id="too few registers"),
        pytest.param(registers(1, 7, 7, 7), True, id="too many registers"),
        pytest.param(registers(1, 7, 7)[:-1] + b"\0", True, id="wrong checksum"),
        pytest.param(registers(1, 7, 7)[:-3], True, id="truncated"),
        pytest.param(b"\xff" * 300, False, id="babble"),
    ],
)
async def test_what_is_not_our_answer_is_reported_and_not_used(answer: bytes, heard: bool) -> None:
    """heard: whether the unit may have sent it; a unit that is heard is not silent"""
    async with line() as (bus, peer):
        peer.reply = lambda _: answer
        with pytest.raises(BadAnswer, match=r"unit 1|does not fit function 4") as caught:
            await bus.read("d", 1, TWO)
        assert caught.value.heard is heard
        peer.reply = honest
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_a_device_that_answers_with_its_own_id_is_recognised_by_it() -> None:
    """Some devices answer to every id, with their own."""
    async with line() as (bus, peer):
        peer.reply = lambda _: registers(5, 7, 7)
        with pytest.raises(BadAnswer, match=r"unit 5 answered instead of unit 1 .*ask it as unit 5"):
            await bus.read("d", 1, TWO)


async def test_another_units_late_answer_is_not_called_an_answer_instead() -> None:
    async with line() as (bus, peer):
        with pytest.raises(NoAnswer):
            await bus.read("d", 5, TWO)
        peer.reply = lambda _: registers(5, 7, 7)
        with pytest.raises(NoAnswer, match="unit 1 did not answer"):
            await bus.read("d", 1, TWO)


async def test_answer_is_found_among_garbage() -> None:
    async with line() as (bus, peer):
        peer.reply = lambda request: b"\x00\x01\x04\xff" + registers(2, 7, 7) + honest(request)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_answer_may_come_byte_by_byte() -> None:
    async with line() as (bus, peer):
        asked = asyncio.ensure_future(bus.read("d", 1, TWO))
        await peer.is_asked.wait()
        for byte in registers(1, 7, 8):
            peer.port.write(bytes([byte]))
            await asyncio.sleep(0.001)
        assert await asked == (7, 8)


@pytest.mark.parametrize(("code", "error"), [(2, Refused), (4, Refused), (10, NoAnswer), (11, NoAnswer), (99, Refused)])
async def test_an_exception_code_is_a_refusal_or_no_answer(code: int, error: type[DriverError]) -> None:
    async with line() as (bus, peer):
        peer.reply = lambda _: frame(bytes((1, 0x84, code)))
        with pytest.raises(error, match=f"exception {code}"):
            await bus.read("d", 1, TWO)


async def test_port_that_is_missing_or_taken_says_what_to_do() -> None:
    with pytest.raises(ConnectError, match="/dev/serial/by-id"):
        await ModbusRtuBus("b", ModbusRtuSettings(port="/dev/does-not-exist")).connect()
    async with line() as (_, peer):
        taken = ModbusRtuBus("b", ModbusRtuSettings(port=peer.path))
        with pytest.raises(ConnectError, match="another program has it open"):
            await taken.connect()


@given(st.binary(max_size=300))
def test_arbitrary_bytes_are_no_answer(heard: bytes) -> None:
    """A message is only found where a complete frame of our request with the right checksum stands."""
    message = find_rtu_answer(heard, 1, TWO)
    assert message is None or frame(b"\x01" + message) in heard


@given(before=st.binary(max_size=40), after=st.binary(max_size=40), words=st.tuples(*[st.integers(0, 65535)] * 2))
def test_answer_is_found_wherever_it_stands(before: bytes, after: bytes, words: tuple[int, int]) -> None:
    answer = registers(1, *words)
    message = find_rtu_answer(before + answer + after, 1, TWO)
    assert message is not None
    if message != answer[1:-2]:  # then the garbage held a valid frame itself
        assert frame(b"\x01" + message) in before + answer + after
