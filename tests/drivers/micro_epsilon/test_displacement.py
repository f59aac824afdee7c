"""Micro-Epsilon RS-485 framing: the manual's example, bad lines, late answers."""

import asyncio
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import BadAnswer, NoAnswer, Quality, SystemClock
from drivers.build import make_device
from drivers.micro_epsilon.rs485 import Counted, MeRs485Bus, decode_counted, decode_float, find_answers, request_frame
from drivers.micro_epsilon.settings import MeRs485Settings
from simulators.devices import MeSensor
from simulators.devices.me_sensor import MeLine, answer_frame, counted_frame
from tests.benches.me_talk import line, value

pytestmark = pytest.mark.simulated_time

EXAMPLE = bytes.fromhex("68 0B 0B 68 01 7E 08 AE 47 61 3F 00 00 00 00 1C 16")
"""The manual's answer: 0.88 unscaled."""


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


def frame_of(address: int, data: bytes, response: int = 8) -> bytes:
    """An answer as the manual describes it, made without driver and emulator."""
    body = bytes([1, address, response, *data])
    return bytes([0x68, len(body), len(body), 0x68, *body, sum(body) % 256, 0x16])


PIECE = st.one_of(
    st.binary(max_size=30),
    st.builds(frame_of, st.sampled_from([0x7E, 0x7D, 0x68]), st.binary(max_size=20), st.sampled_from([8, 8, 8, 9])),
    st.builds(lambda data: frame_of(0x7E, frame_of(0x7E, data)), st.binary(max_size=8)),
    st.sampled_from([b"\x68", b"\x68\x03\x03\x68", b"\x16", EXAMPLE[:-1], EXAMPLE[1:], EXAMPLE]),
)

LATE = st.builds(answer_frame, st.sampled_from([0x7E, 0x7D]), st.floats(0, 1, width=32), st.just(0.0))


@given(st.lists(PIECE, max_size=8).map(b"".join))
def test_every_answer_that_is_taken_stands_whole_in_the_bytes(heard: bytes) -> None:
    start = 0
    for data in find_answers(heard, 0x7E):
        where = heard.find(frame_of(0x7E, data), start)
        assert where >= start, "in order, and no byte counts twice"
        start = where + len(data) + 9


@given(st.lists(st.tuples(st.binary(max_size=20), st.binary(max_size=20), st.sampled_from([0x7E, 0x7D])), max_size=5))
def test_every_answer_of_the_sensor_is_taken_and_no_other(sent: list[tuple[bytes, bytes, int]]) -> None:
    heard = b"".join(noise.replace(b"\x68", b"") + frame_of(address, data) for noise, data, address in sent)
    assert find_answers(heard, 0x7E) == [data for _, data, address in sent if address == 0x7E]


def test_last_of_several_counted_values_is_taken() -> None:
    (data,) = find_answers(counted_frame(0x7E, 65535, [1, -2, 0xF00000]), 0x7E)
    assert decode_counted(data) == Counted(65535, (1, -2, 0xF00000))


@given(st.binary(max_size=40))
def test_any_payload_is_decoded_or_refused(data: bytes) -> None:
    for decode in (decode_float, decode_counted):
        try:
            number = decode(data)
        except ValueError:
            continue
        assert len(data) == 8 if isinstance(number, float) else len(data) == 4 + 4 * len(number.counts)


async def _reads(junk: bytes, late: bytes, following: float) -> bytes | None:
    """The value that is taken from junk, if any; the next read must give `following`, whatever still comes late."""
    first: bytes | None = None

    def reply(number: int) -> bytes:
        if number == 1:
            return junk
        return (late if first is None else b"") + answer_frame(0x7E, following, 0)

    async with line(reply) as bus:
        with suppress(NoAnswer, BadAnswer):
            first = await bus.measure("d", 0x7E)
        assert value(await bus.measure("d", 0x7E)) == pytest.approx(following)
    return first


def test_whatever_came_before_the_next_read_is_right() -> None:
    """Nothing, garbage, another sensor's answer or several: a value that is taken was there, and is not taken again."""
    with asyncio.Runner() as runner:

        @settings(max_examples=40)
        @given(st.lists(PIECE, max_size=4).map(b"".join), st.lists(LATE, max_size=2), st.floats(0, 1, width=32))
        def anything(junk: bytes, late: list[bytes], following: float) -> None:
            first = runner.run(_reads(junk, b"".join(late), following))
            assert first is None if not find_answers(junk, 0x7E) else frame_of(0x7E, first or b"") in junk

        anything()


async def test_late_answer_is_not_taken_for_the_next() -> None:
    def reply(number: int) -> bytes:
        return b"" if number == 1 else answer_frame(0x7E, 0.1, 0) * (number == 2) + answer_frame(0x7E, 0.5, 0)

    async with line(reply) as bus:
        with pytest.raises(NoAnswer):
            await bus.measure("d", 0x7E)
        for _ in range(2):
            assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.5)


async def test_late_answer_that_comes_alone_is_waited_past() -> None:
    sensor = MeSensor(lambda: [250.0], range_um=500.0)
    wire = MeLine([sensor])
    bus = MeRs485Bus("bus1", MeRs485Settings(port=await wire.start(), timeout_s=0.2))
    try:
        await bus.connect()
        sensor.faults.silent = True
        with pytest.raises(NoAnswer):
            await bus.measure("d", 0x7E)
        sensor.faults.silent = False
        wire.spoil = lambda _, frame: [(0.0, answer_frame(0x7E, 0.1, 0)), (0.03, frame)]
        assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.5)
    finally:
        await bus.close()
        await wire.stop()


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
async def test_what_is_not_our_answer_is_reported(answer: bytes) -> None:
    async with line(lambda n: answer if n == 1 else EXAMPLE) as bus:
        with pytest.raises(BadAnswer, match="no valid answer of 0x7E"):
            await bus.measure("d", 0x7E)
        assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.88)


async def test_fast_answers_are_not_waited_for() -> None:
    async with line(lambda _: EXAMPLE) as bus:
        loop = asyncio.get_running_loop()
        started = loop.time()
        for _ in range(20):
            await bus.measure("d", 0x7E)
        assert loop.time() - started < 20 * 0.05 / 2


async def test_sensor_that_counts_and_repeats_itself_gives_no_values() -> None:
    distance = [250.0]
    sensor = MeSensor(lambda: distance, range_um=500.0, payload="counted")
    bus = MeRs485Bus("bus1", MeRs485Settings(port=await sensor.start(), timeout_s=0.5))
    driver = make_device("growth", bus, "me_dt6120", 0x7E, {"nose": 0}, {"range_um": 500.0}, SystemClock())

    async def quality() -> Quality:
        return (await driver.read())[0].quality

    try:
        await bus.connect()
        await driver.connect()
        assert [await quality() for _ in range(3)] == [Quality.GOOD] * 3, "the same distance, measured again"
        sensor.frozen = True
        assert [await quality() for _ in range(3)] == [Quality.STALE] * 3
        sensor.frozen = False
        assert await quality() is Quality.GOOD
        distance[0] = 0.0
        assert await quality() is Quality.OUT_OF_RANGE
    finally:
        await bus.close()
        await sensor.stop()
