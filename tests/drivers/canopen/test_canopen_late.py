"""Late answers of CANopen nodes, as the bus sees them.

A device of profile 404 asks for its node's device type first, whenever a read of it failed. So its late answers meet a
request for another object, and the fault matrix could not detect a bus that takes them. Here the same object is asked
for again.
"""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from itertools import count
from math import inf

import pytest

from drivers.base import DriverError, NoAnswer
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import SensorFault
from tests.benches.buses import make_bus
from tests.benches.late_answers import Late

pytestmark = pytest.mark.simulated_time

VALUE, OTHER = CanObject(0x9130, 1), CanObject(0x9130, 2)
SDO, TPDOS = 0x585, (0x185, 0x285)
TIMEOUT_S = 0.1
SYNC = 0x080
LATE_S = TIMEOUT_S / 5


class CountingSource:
    """A source that returns a different number each time; keeps the last."""

    def __init__(self) -> None:
        self._next = count(100)
        self.last = 0

    def __call__(self) -> Sequence[float]:
        self.last = next(self._next)
        return [self.last, self.last]


@asynccontextmanager
async def bench(spoil: Late) -> AsyncIterator[tuple[CanOpenBus, CountingSource]]:
    source = CountingSource()
    adapter = SlcanAdapter([Cia404Node(5, source, inputs=2, digits=0)])
    adapter.spoil = spoil
    async with on(adapter) as bus:
        yield bus, source


@asynccontextmanager
async def on(adapter: SlcanAdapter) -> AsyncIterator[CanOpenBus]:
    """A bus on this adapter, all nodes operational."""
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": TIMEOUT_S})
    assert isinstance(bus, CanOpenBus)
    try:
        await bus.connect()
        for node, tpdos in ((5, TPDOS), *((node, (0x180 + node, 0x280 + node)) for node in (6, 7))):
            await bus.start_node("node", node, dict.fromkeys(tpdos, 0.0))
        yield bus
    finally:
        await bus.close()
        await adapter.stop()


async def value_by_sdo(bus: CanOpenBus) -> int:
    (data,) = await bus.upload("node", 5, [VALUE])
    return int.from_bytes(data, "little")


async def value_by_sync(bus: CanOpenBus) -> int:
    frames = await bus.synchronise("node", 5, TPDOS)
    return int.from_bytes(frames[TPDOS[0]].data[:4], "little")


async def test_late_answer_is_not_taken_when_the_same_object_is_asked_again() -> None:
    late = Late((SDO,), TIMEOUT_S / 5)
    async with bench(late) as (bus, source):
        with pytest.raises(NoAnswer):
            await value_by_sdo(bus)
        old = source.last
        late.let_go()
        for _ in range(3):
            try:
                value = await value_by_sdo(bus)
            except DriverError:  # it heard the late one; in the next period that is past
                await asyncio.sleep(TIMEOUT_S)
                continue
            break
        assert value == source.last > old


async def test_node_that_is_always_one_answer_behind_gives_no_value() -> None:
    async with bench(Late((SDO,), TIMEOUT_S / 5)) as (bus, _):
        for _ in range(8):
            with pytest.raises(DriverError):
                await value_by_sdo(bus)


async def test_late_tpdos_are_not_taken_for_those_of_the_next_sync() -> None:
    """They come before whatever the node sends next, because all frames of one node keep their order."""
    late = Late(TPDOS, TIMEOUT_S / 5, before=(SDO, *TPDOS))
    async with bench(late) as (bus, source):
        with pytest.raises(NoAnswer):
            await value_by_sync(bus)
        old = source.last
        late.let_go()
        assert await value_by_sync(bus) > old


@pytest.mark.parametrize("overtaken", [False, True])
@pytest.mark.parametrize("pause_s", [0.0, TIMEOUT_S])
async def test_value_and_status_are_of_the_same_sync(pause_s: float, overtaken: bool) -> None:
    """Every node answers each SYNC, whichever it was sent for. A frame that is still on its way would arrive after the
    next SYNC: a sensor that has broken in between would look whole."""
    late: list[CanFrame] = []

    class Slow(Cia404Node):
        """The last frame after a SYNC waits in its queue; its answers by SDO may overtake it."""

        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            answer = super().on_frame(identifier, data)
            if identifier != SYNC and overtaken:
                return answer
            frames = [*late, *answer]
            late[:] = frames[-1:] if identifier == SYNC else []
            asyncio.get_running_loop().call_later(LATE_S, send_late)
            return frames[: len(frames) - len(late)]

    def send_late() -> None:
        adapter.send(late)
        late.clear()

    whole, broken = [20.0, 20.0], {0: SensorFault.OPEN}
    slow = Slow(6, lambda: whole, inputs=2, digits=0)
    adapter = SlcanAdapter([slow, *(Cia404Node(node, lambda: whole, inputs=2, digits=0) for node in (5, 7))])
    found = []
    async with on(adapter) as bus:
        for fault in ({}, broken, broken, {}, broken, {}):
            for other in (5, 7):
                await bus.synchronise("other", other, (0x180 + other, 0x280 + other))
            slow.faults.by_channel.clear()
            slow.faults.by_channel.update(fault)
            frames = await bus.synchronise("slow", 6, (0x186, 0x286))
            found.append((int.from_bytes(frames[0x186].data[:4], "little") > 800, frames[0x286].data[0] != 0))
            await asyncio.sleep(pause_s)
    assert set(found) == {(False, False), (True, True)}, found


@pytest.mark.parametrize("late_s", [0.2 * TIMEOUT_S, 0.9 * TIMEOUT_S, 1.2 * TIMEOUT_S, 1.9 * TIMEOUT_S])
@pytest.mark.parametrize("between", ["another's is missed", "a timeout passes", "another is read twice"])
async def test_a_sync_that_a_node_has_not_taken_is_not_mixed_with_the_next(late_s: float, between: str) -> None:
    state = {"late": False, "until": 0.0}

    class InOrder(Cia404Node):
        """Its status may be late; later requests are answered after that."""

        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            answer, loop = super().on_frame(identifier, data), asyncio.get_running_loop()
            if identifier == SYNC and state["late"]:
                state["until"] = loop.time() + late_s
                loop.call_at(state["until"], adapter.send, answer[-1:])
                return answer[:-1]
            if loop.time() < state["until"]:
                for number, frame in enumerate(answer):
                    loop.call_at(state["until"] + 0.001 * (1 + number), adapter.send, [frame])
                return []
            return answer

    whole, broken = [20.0, 20.0], {0: SensorFault.OPEN}
    slow = InOrder(6, lambda: whole, inputs=2, digits=0)
    adapter = SlcanAdapter([slow, *(Cia404Node(node, lambda: whole, inputs=2, digits=0) for node in (5, 7))])
    found = []
    async with on(adapter) as bus:
        for before, after in 4 * [({}, broken), (broken, {})]:
            slow.faults.by_channel, state["late"] = dict(before), True
            with suppress(NoAnswer):
                await bus.synchronise("other", 5, (0x185, 0x485 if between == "another's is missed" else 0x285))
            slow.faults.by_channel, state["late"] = dict(after), False
            if between != "another's is missed":
                await asyncio.sleep(1.05 * TIMEOUT_S if between == "a timeout passes" else 0.0)
                await bus.synchronise("other", 5, TPDOS)
            with suppress(NoAnswer):
                frames = await bus.synchronise("slow", 6, (0x186, 0x286))
                found.append((int.from_bytes(frames[0x186].data[:4], "little") > 800, frames[0x286].data[0] != 0))
            await asyncio.sleep(5 * TIMEOUT_S)
    assert found or late_s > TIMEOUT_S, "what is asked after the late frame is answered too late"
    assert set(found) <= {(False, False), (True, True)}, found


async def test_one_sync_serves_all_nodes() -> None:
    """One that was sent since the last read of each."""
    syncs = 0

    class Counting(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            nonlocal syncs
            syncs += identifier == SYNC and self is nodes[0]
            return super().on_frame(identifier, data)

    source = CountingSource()
    nodes = [Counting(node, source, inputs=2, digits=0) for node in (5, 6, 7)]
    async with on(SlcanAdapter(nodes)) as bus:
        for _ in range(4):
            for node in (5, 6, 7):
                await bus.synchronise(f"node {node}", node, (0x180 + node, 0x280 + node))
        assert syncs == 4
        before = source.last
        frames = await bus.synchronise("node 7", 7, (0x187, 0x287))
        assert int.from_bytes(frames[0x187].data[:4], "little") > before, "nothing is taken twice"
        syncs = 0
        await bus.synchronise("node 5", 5, TPDOS)
        await asyncio.sleep(1.1 * TIMEOUT_S)
        await bus.synchronise("node 6", 6, (0x186, 0x286))
        assert syncs == 1, "that of node 7 served node 5, and is too old for node 6"
        await bus.close()
        await bus.connect()
        await bus.synchronise("node 5", 5, TPDOS)
        assert syncs == 2, "nobody knows what came while it was closed"


async def test_node_that_takes_longer_than_the_timeout_is_read() -> None:
    """Where no other node waits for it."""

    class Slow(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            answer = super().on_frame(identifier, data)
            asyncio.get_running_loop().call_later(1.2 * TIMEOUT_S, adapter.send, answer)
            return []

    adapter = SlcanAdapter([Slow(5, lambda: [20.0], inputs=1, digits=0)])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": TIMEOUT_S})
    assert isinstance(bus, CanOpenBus)
    try:
        await bus.connect()
        for _ in range(3):
            with suppress(DriverError):
                await value_by_sdo(bus)
        assert [await value_by_sdo(bus) for _ in range(3)] == [20] * 3
    finally:
        await bus.close()
        await adapter.stop()


async def test_what_is_asked_after_a_lost_answer() -> None:
    """The next object's answer shows that nothing older follows; the same object is asked for after another one."""
    asked, lost = [], [VALUE.address]

    class Losing(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            if identifier != 0x605:
                return super().on_frame(identifier, data)
            asked.append(data[1:4])
            if asked[-1] in lost:
                lost.clear()
                return []
            return super().on_frame(identifier, data)

    async with on(SlcanAdapter([Losing(5, lambda: [20.0, 20.0], inputs=2, digits=0)])) as bus:
        for order in ([OTHER, VALUE], [VALUE]):
            lost.append(VALUE.address)
            with pytest.raises(NoAnswer):
                await bus.upload("node", 5, [VALUE])
            asked.clear()
            bus.limit(0.001)
            with pytest.raises(NoAnswer) as caught:
                await bus.upload("node", 5, [VALUE])
            assert caught.value.what.code == "canopen_no_time"
            assert asked == []
            bus.limit(inf)
            assert [len(data) for data in await bus.upload("node", 5, order)] == [4] * len(order)
            values = {VALUE.address, OTHER.address}
            assert [place in values for place in asked] == [True, True] if len(order) == 2 else [False, True]
