"""Micro-Epsilon RS-485 framing: the manual's example, bad lines, late answers."""

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import BadAnswer, NoAnswer
from drivers.bus_settings import MeRs485Settings
from drivers.me_rs485 import MeRs485Bus, decode_counted, decode_float, find_answers, request_frame
from simulators.devices.me_sensor import answer_frame, counted_frame
from simulators.devices.pty_port import PtyPort

EXAMPLE = bytes.fromhex("68 0B 0B 68 01 7E 08 AE 47 61 3F 00 00 00 00 1C 16")
"""The manual's answer: 0.88 unscaled."""


def value(data: bytes) -> float:
    return float(struct.unpack("<ff", data)[0])


def test_request_is_the_manuals_example() -> None:
    assert request_frame(0x7E) == bytes.fromhex("10 7E 01 4C CB 16")


def test_answer_is_the_manuals_example() -> None:
    (data,) = find_answers(EXAMPLE, 0x7E)
    assert value(data) == pytest.approx(0.88)


def test_emulated_sensor_sends_the_manuals_example() -> None:
    assert answer_frame(0x7E, 0.88, 0.0) == EXAMPLE


@pytest.mark.parametrize("position", range(len(EXAMPLE)))
def test_any_flipped_bit_makes_the_answer_invalid(position: int) -> None:
    for bit in range(8):
        broken = bytearray(EXAMPLE)
        broken[position] ^= 1 << bit
        assert find_answers(broken, 0x7E) == []


@given(before=st.binary(max_size=50), after=st.binary(max_size=50))
def test_answer_is_found_among_garbage(before: bytes, after: bytes) -> None:
    heard = before + EXAMPLE + after
    found = find_answers(heard, 0x7E)
    assert all(len(data) + 9 <= len(heard) for data in found)
    if 0x68 not in before:
        assert value(found[0]) == pytest.approx(0.88)


def test_last_of_several_counted_values_is_taken() -> None:
    (data,) = find_answers(counted_frame(0x7E, 65535, [1, -2, 0xF00000]), 0x7E)
    assert decode_counted(data) == 0xF00000


@given(st.binary(max_size=40))
def test_any_payload_is_decoded_or_refused(data: bytes) -> None:
    for decode in (decode_float, decode_counted):
        try:
            number = decode(data)
        except ValueError:
            continue
        assert isinstance(number, float)
        assert len(data) == 8 if decode is decode_float else len(data) == 4 + 4 * data[2]


@asynccontextmanager
async def line(reply: Callable[[int], bytes], timeout_s: float = 0.05) -> AsyncIterator[MeRs485Bus]:
    """A peer that answers its n-th request (from 1) with reply(n), and a bus connected to it."""
    count = 0

    def on_bytes(_: bytes) -> None:
        nonlocal count
        count += 1
        port.write(reply(count))

    port = PtyPort(on_bytes)
    bus = MeRs485Bus("bus1", MeRs485Settings(port=await port.start(), timeout_s=timeout_s))
    try:
        await bus.connect()
        yield bus
    finally:
        await bus.close()
        await port.stop()


async def test_late_answer_is_not_taken_for_the_next() -> None:
    def reply(number: int) -> bytes:
        return b"" if number == 1 else answer_frame(0x7E, 0.1, 0) * (number == 2) + answer_frame(0x7E, 0.5, 0)

    async with line(reply) as bus:
        with pytest.raises(NoAnswer):
            await bus.measure("d", 0x7E)
        for _ in range(2):
            assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.5)


async def test_sensor_beside_a_silent_one_is_not_waited_for() -> None:
    def reply(number: int) -> bytes:
        return b"" if number % 2 else answer_frame(0x7D, 0.1, 0) + answer_frame(0x7E, 0.5, 0)

    async with line(reply, timeout_s=0.4) as bus:
        loop = asyncio.get_running_loop()
        for _ in range(3):
            with pytest.raises(NoAnswer):
                await bus.measure("dead", 0x7D)
            begun = loop.time()
            assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.5)  # not the other's, which comes late
            assert loop.time() - begun < 0.2


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(answer_frame(0x7D, 0.5, 0), id="another sensor"),
        pytest.param(EXAMPLE[:-1] + b"\0", id="wrong end"),
        pytest.param(EXAMPLE[:-4], id="truncated"),
    ],
)
async def test_what_is_not_our_answer_is_told(answer: bytes) -> None:
    async with line(lambda n: answer if n == 1 else EXAMPLE) as bus:
        with pytest.raises(BadAnswer, match="none of them a valid answer of 0x7E"):
            await bus.measure("d", 0x7E)
        assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.88)


async def test_fast_answers_are_not_waited_for() -> None:
    async with line(lambda _: EXAMPLE) as bus:
        loop = asyncio.get_running_loop()
        started = loop.time()
        for _ in range(20):
            await bus.measure("d", 0x7E)
        assert loop.time() - started < 20 * 0.05 / 2
