"""A device with several blocks: each block is asked for again by itself, and an answered block is never asked for
twice."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager

import pytest

from drivers.base import Driver, NoAnswer, Quality, SystemClock
from drivers.build import make_device
from drivers.modbus.answers import BlockAnswers
from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.settings import ModbusTcpSettings
from drivers.requests import Requests
from simulators.devices import M7015, RtuLine
from simulators.devices.loopback import Connection, LoopbackServer
from tests.benches.buses import make_bus
from tests.benches.rtu_talk import TWO, frame, honest, line

pytestmark = pytest.mark.simulated_time

BITS, ONE, OTHER_ONE = Block(2, 128, 1), Block(4, 0, 1), Block(4, 9, 1)
FC_COIL, FC_BITS, FC_TYPES, FC_VALUES = 1, 2, 3, 4


def asked_in_turn(requests: list[Block], misses: int, *, in_order: bool = False) -> list[Block]:
    answers = BlockAnswers()
    turns: list[Block] = []
    for _ in range(misses):
        request = answers.next_of(requests, in_order=in_order)
        assert request is not None
        answers.missed(request)
        turns.append(request)
    return turns


def test_a_request_that_is_not_answered_comes_after_the_others() -> None:
    assert asked_in_turn([BITS, ONE, TWO], 7) == [BITS, ONE, TWO, BITS, ONE, TWO, BITS]


def test_an_answered_request_is_asked_no_more() -> None:
    answers = BlockAnswers()
    answers.missed(BITS)
    answers.add(ONE, (7,))
    assert answers.next_of([BITS, ONE], in_order=False) == BITS
    answers.add(BITS, (1,))
    assert answers.next_of([BITS, ONE], in_order=False) is None
    assert answers.words([BITS, ONE]) == {(2, 128): 1, (4, 0): 7}


def test_requests_whose_answers_look_the_same_wait_for_one_another() -> None:
    assert asked_in_turn([ONE, OTHER_ONE], 3) == [ONE, ONE, ONE]
    assert asked_in_turn([ONE, OTHER_ONE, BITS], 4) == [ONE, BITS, ONE, BITS]


def test_values_that_are_read_between_two_states_keep_their_order() -> None:
    assert asked_in_turn([BITS, ONE], 3, in_order=True) == [BITS, BITS, BITS]


def test_a_unit_whose_missing_answers_come_is_waited_for_and_another_one_is_not() -> None:
    requests, now_s = Requests[Block](numbered=False), 0.0
    answer, other = bytes((4, 2, 0, 7)), bytes((4, 4, 0, 7, 0, 8))

    def is_missing(unit: int, *, comes: bool) -> None:
        nonlocal now_s
        now_s += 1.0
        requests.begin(unit, now_s)
        requests.sent(unit, ONE, now_s)
        requests.missed(unit, ONE)
        if comes:
            assert requests.came(unit, answer, now_s + 0.6)
        else:
            requests.sent(unit, TWO, now_s + 0.5)
            assert requests.came(unit, other, now_s + 0.6)
        requests.begin(unit, now_s + 0.7)

    assert requests.patience_s(1) == 0.0
    assert not requests.loses(1)
    for _ in range(3):
        is_missing(1, comes=True)
        is_missing(2, comes=False)
    assert requests.patience_s(1) == pytest.approx(1.25 * 0.6)
    assert (requests.loses(1), requests.loses(2), requests.loses(3)) == (False, True, False)
    assert requests.patience_s(2) == 0.0
    for _ in range(12):
        is_missing(1, comes=False)
    assert requests.patience_s(1) == 0.0
    assert requests.loses(1)


def first(lost: Mapping[int, int]) -> Callable[[int], bool]:
    """Loses so many answers of each function."""
    left = Counter(lost)

    def swallow(function: int) -> bool:
        left[function] -= 1
        return left[function] >= 0

    return swallow


@asynccontextmanager
async def module(swallow: Callable[[int], bool]) -> AsyncIterator[tuple[Driver, list[int]]]:
    """An M-7015 that was read once, and then loses its answers of the functions in `swallow`; and what it was asked."""
    degc = [20.0]
    wire = RtuLine({1: M7015(lambda: degc * 6)})
    asked: list[int] = []
    path = await wire.start()
    bus = make_bus("rtu", "modbus_rtu", {"port": path, "timeout_s": 0.4})
    driver = make_device("module", bus, "icpdas_m7015", 1, {"in0": 0}, {}, SystemClock())
    try:
        await bus.connect()
        await driver.connect()
        await driver.read()

        def spoil(_unit: int, answer: bytes) -> list[tuple[float, bytes]]:
            asked.append(answer[1])
            return [] if swallow(answer[1]) else [(0.0, answer)]

        wire.spoil = spoil
        degc[0] = 30.0
        yield driver, asked
    finally:
        await bus.close()
        await wire.stop()


async def test_a_lost_block_does_not_keep_the_other_from_being_read() -> None:
    async with module(first({FC_BITS: 2, FC_VALUES: 1})) as (driver, asked):
        with pytest.raises(NoAnswer) as nothing:
            await driver.read()
        assert not nothing.value.heard
        for _ in range(2):
            with pytest.raises(NoAnswer):
                await driver.read(again=True)
        (reading,) = await driver.read(again=True)
    assert reading.quality is Quality.GOOD
    assert reading.value == pytest.approx(30.0)
    assert asked == [FC_BITS, FC_VALUES, FC_BITS, FC_VALUES, FC_BITS]


async def test_a_check_that_was_disturbed_continues_where_it_was() -> None:
    async with module(first({FC_TYPES: 1})) as (driver, asked):
        await driver.close()
        with pytest.raises(NoAnswer) as nothing:
            await driver.connect()
        assert nothing.value.heard, "it has answered one of two"
        await driver.connect()
    assert asked == [FC_COIL, FC_TYPES, FC_TYPES]


async def test_a_check_that_was_disturbed_begins_again_once_another_module_may_answer() -> None:
    async with module(first({FC_TYPES: 1})) as (driver, asked):
        await driver.close()
        with pytest.raises(NoAnswer):
            await driver.connect()
        await asyncio.sleep(3.0)
        await driver.connect()
    assert asked == [FC_COIL, FC_TYPES, FC_TYPES, FC_COIL, FC_TYPES], "not only what was not answered"


async def test_a_late_answer_is_used_though_another_block_was_asked_meanwhile() -> None:
    """The answer to the bits comes with that to the registers."""
    late: list[bytes] = []
    async with line() as (bus, peer):

        def reply(request: bytes) -> bytes:
            if request[1] == FC_BITS:
                late.append(request)
                return b""
            return frame(bytes((1, FC_BITS, 1, 1))) + honest(request)

        peer.reply = reply
        with pytest.raises(NoAnswer):
            await bus.read("module", 1, BITS)
        assert await bus.read("module", 1, TWO, again=True) == (100, 101)
        assert await bus.read("module", 1, BITS, again=True) == (1,)
        assert len(late) == 1, "it was not asked for again"
        with pytest.raises(NoAnswer):
            await bus.read("module", 1, BITS)
        assert len(late) == 2, "the next question needs its own answer"


async def test_no_request_waits_beyond_the_limit() -> None:
    server = LoopbackServer(Connection)
    port = await server.start()
    tcp = ModbusTcpBus("tcp", ModbusTcpSettings(host="127.0.0.1", port=port, timeout_s=0.5))
    await tcp.connect()
    try:
        async with line(timeout_s=0.5) as (rtu, peer):
            await _ends_in_time(tcp)
            await _ends_in_time(rtu)
            assert len(peer.requests) == 1, "one for which no time is left is not sent"
            rtu.limit(0.02)
            with pytest.raises(NoAnswer, match="no time was left"):
                await rtu.read("silent", 1, TWO)
            assert len(peer.requests) == 1, "nor one that could be answered only in the next period"
    finally:
        await tcp.close()
        await server.stop()


async def _ends_in_time(bus: ModbusTcpBus | ModbusRtuBus) -> None:
    clock = SystemClock()
    began_s = clock.monotonic()
    bus.limit(0.2)
    for _ in range(2):
        with pytest.raises(NoAnswer):
            await bus.read("silent", 1, TWO, again=True)
    assert clock.monotonic() - began_s == pytest.approx(0.2, abs=0.02)
