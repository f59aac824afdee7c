"""Answers that come twice, as from a radio link: the copy is never taken for the answer to the next request."""

import asyncio

import pytest

from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus
from tests.benches.rtu_talk import RtuPeer, honest, line

pytestmark = pytest.mark.simulated_time

BLOCKS = (Block(4, 0, 2), Block(4, 10, 2), Block(4, 20, 2))
"""Their answers look the same."""
PERIOD_S = 1.0


def twice(peer: RtuPeer, by_s: float, first: int) -> None:
    """From now on register n contains first + n, and each short answer comes once more after this time."""

    def reply(request: bytes) -> bytes:
        answer = honest(request, first + int.from_bytes(request[2:4], "big"))
        if by_s < PERIOD_S:
            asyncio.get_running_loop().call_later(by_s, peer.port.write, answer)
        return answer

    peer.reply = reply


async def period(bus: ModbusRtuBus) -> list[tuple[int, ...]]:
    """What is read of the three blocks in one period."""
    read = [await bus.read("d", 1, block) for block in BLOCKS]
    await asyncio.sleep(PERIOD_S)
    return read


@pytest.mark.parametrize("by_s", [0.0, 0.002, 0.01, 0.03, 0.06])
async def test_no_copy_is_taken_for_the_next_answer(by_s: float) -> None:
    async with line() as (bus, peer):
        for number in range(8):
            twice(peer, by_s, 100 * number)
            values = [100 * number + block.address for block in BLOCKS]
            assert await period(bus) == [(value, value + 1) for value in values], number


async def test_once_it_is_known_the_copy_is_awaited_and_costs_no_request() -> None:
    async with line() as (bus, peer):
        twice(peer, 0.03, 100)
        for _ in range(3):
            await period(bus)
        peer.requests.clear()
        await period(bus)
        assert len(peer.requests) == len(BLOCKS)


async def test_blocks_that_hold_the_same_words_are_asked_for_once_more_only_at_first() -> None:
    async with line() as (bus, peer):
        peer.reply = lambda request: honest(request, 100)
        asked = []
        for _ in range(5):
            peer.requests.clear()
            assert await period(bus) == [(100, 101)] * len(BLOCKS)
            asked.append(len(peer.requests))
    assert asked == [8, 7, 7, 3, 3], "two requests more for each pair, three times; one, as equal answers came at once"


async def test_blocks_that_differ_again_are_suspected_again() -> None:
    """They were found equal often enough; then a repeater is put into the line."""
    async with line() as (bus, peer):
        peer.reply = lambda request: honest(request, 100)
        for _ in range(4):
            await period(bus)
        twice(peer, PERIOD_S, 200)
        await period(bus)
        for number in range(3, 8):
            twice(peer, 0.002, 100 * number)
            values = [100 * number + block.address for block in BLOCKS]
            assert await period(bus) == [(value, value + 1) for value in values], number


async def test_a_line_without_copies_is_not_slowed_down() -> None:
    async with line() as (bus, peer):
        for number in range(3):
            twice(peer, 1e6, number)
            peer.requests.clear()
            await period(bus)
            assert len(peer.requests) == len(BLOCKS)
