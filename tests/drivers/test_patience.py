"""How long the drivers wait for answers, and what follows a wait that was cut short."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import NoAnswer
from drivers.byte_stream import TcpStream
from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.settings import ModbusTcpSettings
from drivers.patience import Patience
from simulators.devices import SlcanAdapter
from simulators.devices.loopback import Connection, LoopbackServer
from simulators.devices.me_sensor import answer_frame
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.can_talk import NODE, VALUE, talking
from tests.benches.me_talk import line as me_line
from tests.benches.me_talk import value
from tests.benches.rtu_talk import TWO, honest, registers
from tests.benches.rtu_talk import line as rtu_line

pytestmark = pytest.mark.simulated_time

LONGEST_S = 0.5


def learnt(took_s: float, count: int = 20) -> Patience:
    patience = Patience(LONGEST_S)
    for _ in range(count):
        patience.answered(1, "values", took_s)
    return patience


def test_an_unknown_unit_gets_all_the_time() -> None:
    patience = Patience(LONGEST_S)
    assert patience.wait_s(1, "values") == LONGEST_S
    for _ in range(3):
        patience.answered(1, "values", 0.01)
        assert patience.wait_s(1, "values") == LONGEST_S
    patience.answered(1, "values", 0.01)
    assert patience.wait_s(1, "values") == 0.05
    assert patience.wait_s(2, "values") == LONGEST_S
    assert patience.wait_s(1, "another request, which may take longer") == LONGEST_S


def test_after_a_miss_every_request_to_that_unit_gets_all_the_time_until_it_is_answered() -> None:
    patience = learnt(0.01)
    for _ in range(4):
        patience.answered(1, "type", 0.01)
        patience.answered(2, "values", 0.01)
    patience.missed(1)
    assert patience.wait_s(1, "values") == patience.wait_s(1, "type") == LONGEST_S
    assert patience.wait_s(2, "values") == 0.05
    patience.answered(1, "values", 0.01)
    assert patience.wait_s(1, "values") == 0.05
    assert patience.wait_s(1, "type") == LONGEST_S


def repeating(took_s: float, count: int = 20) -> Patience:
    """A unit that is asked again soon."""
    patience = Patience(LONGEST_S, 2.0)
    for request in ("values", "type"):
        for _ in range(count):
            patience.answered(1, request, took_s)
    return patience


def test_where_a_request_is_repeated_the_wait_grows_with_each_miss_of_it_until_it_is_answered() -> None:
    patience = repeating(0.01)
    waits_s = []
    for _ in range(6):
        waits_s.append(patience.wait_s(1, "values"))
        patience.missed(1, "values")
    assert waits_s == [0.05, 0.1, 0.2, 0.4, LONGEST_S, LONGEST_S]
    assert patience.wait_s(1, "type") == 0.05
    patience.answered(1, "type", 0.01)
    assert patience.wait_s(1, "values") == LONGEST_S, "or a unit that is slow in one request would never answer it"
    patience.answered(1, "values", 0.01)
    assert patience.wait_s(1, "values") == 0.05


def test_where_a_request_is_repeated_one_answer_is_enough_and_an_outlier_costs_half_the_time_at_most() -> None:
    assert repeating(0.01, 1).wait_s(1, "values") == 0.05
    assert repeating(0.1, 1).wait_s(1, "values") == LONGEST_S / 2
    assert repeating(0.4).wait_s(1, "values") == pytest.approx(0.4, abs=0.1), "but one that is always slow has its time"
    patience = repeating(0.01)
    patience.answered(1, "values", LONGEST_S)
    assert patience.wait_s(1, "values") == LONGEST_S / 2


def test_a_unit_that_has_become_slow_is_given_the_time_after_one_answer() -> None:
    patience = learnt(0.01)
    patience.missed(1)
    patience.answered(1, "values", 0.2)
    assert patience.wait_s(1, "values") > 0.2


def test_all_are_given_more_for_a_while_when_one_answer_was_late() -> None:
    patience = learnt(0.01)
    for _ in range(20):
        patience.answered(2, "values", 0.01)
    patience.answered(2, "values", 0.06)
    assert patience.wait_s(1, "values") == pytest.approx(0.11, abs=0.002)
    for _ in range(100):
        patience.answered(2, "values", 0.01)
    assert patience.wait_s(1, "values") == 0.05
    patience.answered(2, "values", 0.4)
    assert patience.wait_s(1, "values") == pytest.approx(0.11, abs=0.002), "no more for one that is slow by itself"


def test_a_slow_unit_is_never_given_more_than_the_timeout() -> None:
    assert learnt(0.49).wait_s(1, "values") <= LONGEST_S
    assert learnt(0.1, 100).wait_s(1, "values") == pytest.approx(0.1, abs=0.01)


@pytest.mark.slow
@given(st.lists(st.floats(0, 0.4), min_size=4, max_size=200))
def test_the_wait_is_longer_than_the_mean_of_late_and_within_bounds(took_s: list[float]) -> None:
    patience = Patience(LONGEST_S)
    for one in took_s:
        patience.answered(1, "values", one)
    assert max(0.05, min(took_s)) <= patience.wait_s(1, "values") <= LONGEST_S


async def missed(asking: Callable[[], object]) -> float:
    """How long it takes until the request counts as not answered; the text says so too."""
    begun = time.monotonic()
    with pytest.raises(NoAnswer, match=r"within 0\.[01]"):
        await asking()  # type: ignore[misc]
    return time.monotonic() - begun


async def test_modbus_rtu_waits_shortly_for_a_quick_unit_and_takes_no_late_answer_for_the_next() -> None:
    async with rtu_line(LONGEST_S) as (bus, peer):
        peer.reply = honest
        for _ in range(5):
            assert await bus.read("d", 1, TWO) == (100, 101)
        peer.reply = lambda _: b""
        assert await missed(lambda: bus.read("d", 1, TWO)) < LONGEST_S / 2
        asked = len(peer.requests)
        # The late answer comes while the next request of the same unit waits, and that one is late too.
        late = [registers(1, 7, 7)]

        def later(request: bytes) -> bytes:
            asyncio.get_running_loop().call_later(0.07, peer.port.write, honest(request))
            return late.pop() if late else b""

        peer.reply = later
        assert await bus.read("d", 1, TWO) == (100, 101)
        assert len(peer.requests) == asked + 2


async def test_modbus_rtu_lets_an_answer_end_that_has_begun() -> None:
    async with rtu_line(LONGEST_S) as (bus, peer):
        peer.reply = honest
        for _ in range(5):
            await bus.read("d", 1, TWO)
        peer.reply = lambda request: honest(request)[:2]
        asked = asyncio.ensure_future(bus.read("d", 1, TWO))
        for byte in registers(1, 100, 101)[2:]:
            await asyncio.sleep(0.02)
            peer.port.write(bytes([byte]))
        assert await asked == (100, 101)


async def test_what_came_while_the_event_loop_was_too_busy_to_look_came_in_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        stream = TcpStream("b", "127.0.0.1", server.getsockname()[1])
        await stream.open(1.0)
        peer, _ = server.accept()
        with peer:
            reading = asyncio.ensure_future(stream.read(0.05))
            await asyncio.sleep(0.01)
            peer.sendall(b"answer")
            time.sleep(0.1)  # noqa: ASYNC251 - it is what makes the loop miss its timer
            assert await reading == b"answer"
            with pytest.raises(TimeoutError):
                await stream.read(0.05)
        await stream.close()


class SerialGateway(Connection):
    """Asks one unit after the other on its line, and waits for a silent one before it says so."""

    its_timeout_s = 0.3

    def __init__(self, silent: set[int]) -> None:
        super().__init__()
        self._silent, self._free_s = silent, 0.0

    def data_received(self, data: bytes) -> None:
        loop = asyncio.get_running_loop()
        for start in range(0, len(data), 12):
            request = data[start : start + 12]
            unit = request[6]
            self._free_s = max(loop.time(), self._free_s) + (self.its_timeout_s if unit in self._silent else 0.005)
            body = bytes((0x84, 11)) if unit in self._silent else bytes((4, 4, 0, unit, 0, unit))
            assert self.transport is not None
            answer = request[:4] + (len(body) + 1).to_bytes(2, "big") + request[6:7] + body
            loop.call_at(self._free_s, self.transport.write, answer)


class Dead(SerialGateway):
    """Falls silent as a whole when one unit does."""

    def data_received(self, data: bytes) -> None:
        if not self._silent:
            super().data_received(data)


@asynccontextmanager
async def host(kind: type[SerialGateway], *silent: int) -> AsyncIterator[ModbusTcpBus]:
    """Units 1 to 5, some of which fall silent once all have answered often enough to be known."""
    gone = set[int]()
    server = LoopbackServer(lambda: kind(gone))
    bus = ModbusTcpBus("b", ModbusTcpSettings(host="127.0.0.1", port=await server.start(), timeout_s=LONGEST_S))
    await bus.connect()
    try:
        for _ in range(5):
            for unit in range(1, 6):
                assert await bus.read("d", unit, TWO) == (unit, unit)
        gone |= set(silent)
        yield bus
    finally:
        await bus.close()
        await server.stop()


async def test_units_behind_a_gateway_that_waits_for_a_silent_one_are_given_the_time() -> None:
    async with host(SerialGateway, 1) as bus:
        assert await missed(lambda: bus.read("d", 1, TWO)) < LONGEST_S / 2
        for unit in (2, 3, 4, 5):
            assert await bus.read("d", unit, TWO) == (unit, unit)
        with pytest.raises(NoAnswer, match="gateway target did not respond"):
            await bus.read("d", 1, TWO)


async def test_units_behind_a_gateway_that_waits_for_two_silent_ones_are_given_the_time() -> None:
    async with host(SerialGateway, 1, 2) as bus:
        for unit in (1, 2):
            with pytest.raises(NoAnswer):
                await bus.read("d", unit, TWO)
        for unit in (3, 4, 5):
            assert await bus.read("d", unit, TWO) == (unit, unit)


async def test_a_silent_host_is_given_the_full_timeout_once() -> None:
    async with host(Dead, 1) as bus:
        begun = time.monotonic()
        for unit in range(1, 6):
            with pytest.raises(NoAnswer):
                await bus.read("d", unit, TWO)
        assert time.monotonic() - begun < 2 * LONGEST_S


@pytest.mark.parametrize("between", ["request and answer of another", "the next request and its answer"])
async def test_me_rs485_waits_shortly_for_a_quick_sensor_and_then_until_all_that_is_due_has_come(between: str) -> None:
    late, right = answer_frame(0x7E, 0.1, 0), answer_frame(0x7E, 0.5, 0)

    def reply(number: int) -> bytes:
        match number, between:
            case 6, _:
                return b""
            case 7, "request and answer of another":
                return late + answer_frame(0x7D, 0.2, 0)
            case 7, _:
                return answer_frame(0x7D, 0.2, 0)
            case 8, "the next request and its answer":
                return late + right
            case _:
                return right

    async with me_line(reply, timeout_s=LONGEST_S) as bus:
        for _ in range(5):
            await bus.measure("d", 0x7E)
        assert await missed(lambda: bus.measure("d", 0x7E)) < LONGEST_S / 2
        assert value(await bus.measure("other", 0x7D)) == pytest.approx(0.2)
        for _ in range(2):
            begun = time.monotonic()
            assert value(await bus.measure("d", 0x7E)) == pytest.approx(0.5)
            assert time.monotonic() - begun < LONGEST_S / 2


class SlowAtTimes:
    """A node whose answers take as long as the test says."""

    def __init__(self) -> None:
        self.late_s: list[float] = []
        self.adapter: SlcanAdapter | None = None
        self.asked: list[bytes] = []

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier != 0x600 + NODE or data[0] != 0x40:
            return ()
        self.asked.append(data)
        answer = 0x580 + NODE, b"\x43" + data[1:4] + len(self.asked).to_bytes(4, "little")
        if not self.late_s:
            return (answer,)
        assert self.adapter is not None
        asyncio.get_running_loop().call_later(self.late_s.pop(0), self.adapter.send, [answer])
        return ()


async def test_canopen_waits_shortly_for_a_quick_node_and_passes_over_its_late_answers() -> None:
    node = SlowAtTimes()
    async with talking(node, LONGEST_S) as (bus, adapter):
        node.adapter = adapter
        for number in range(1, 6):
            assert await bus.upload("d", NODE, [VALUE]) == [number.to_bytes(4, "little")]
        node.late_s = [0.3, 0.3, 0.3]
        assert await missed(lambda: bus.upload("d", NODE, [VALUE])) < LONGEST_S / 2
        # The late answer comes first, then the one to what is never a value, then this.
        assert await bus.upload("d", NODE, [VALUE]) == [(8).to_bytes(4, "little")]
        assert [data[1:3] for data in node.asked[-2:]] == [b"\x00\x10", VALUE.index.to_bytes(2, "little")]
