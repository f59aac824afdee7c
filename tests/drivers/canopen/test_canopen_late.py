"""Late answers of CANopen nodes, as the bus sees them.

A device of profile 404 asks for its node's device type first, whenever a read of it failed. So its late answers meet a
request for another object, and the fault matrix could not tell a bus that takes them. Here the same is asked again.
"""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from itertools import count

import pytest

from drivers.base import DriverError, NoAnswer
from drivers.build import make_bus
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import SensorFault
from simulators.devices.spoil import Late

pytestmark = pytest.mark.simulated_time

VALUE = CanObject(0x9130, 1)
SDO, TPDOS = 0x585, (0x185, 0x285)
TIMEOUT_S = 0.1
SYNC = 0x080


class CountingSource:
    """A source that says another number each time; keeps the last."""

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
        await bus.start_node("all", 0, ())  # NMT: 0 is every node
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
    """They come before whatever the node sends then, as all frames of one node keep their order."""
    late = Late(TPDOS, TIMEOUT_S / 5, before=(SDO, *TPDOS))
    async with bench(late) as (bus, source):
        with pytest.raises(NoAnswer):
            await value_by_sync(bus)
        old = source.last
        late.let_go()
        assert await value_by_sync(bus) > old


async def test_value_and_status_are_of_the_same_sync() -> None:
    """Every node answers each SYNC, whichever it was sent for. What is still on its way would arrive after the next: a
    sensor that has broken in between would pass for whole."""
    late: list[CanFrame] = []

    class Slow(Cia404Node):
        """The last frame after a SYNC waits in its queue; nothing overtakes it."""

        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            frames = [*late, *super().on_frame(identifier, data)]
            late[:] = frames[-1:] if identifier == SYNC else []
            asyncio.get_running_loop().call_later(TIMEOUT_S / 5, send_late)
            return frames[: len(frames) - len(late)]

    def send_late() -> None:
        adapter.send(late)
        late.clear()

    slow = Slow(6, lambda: [20.0, 20.0], inputs=2, digits=0)
    adapter = SlcanAdapter([Cia404Node(5, lambda: [20.0, 20.0], inputs=2, digits=0), slow])
    async with on(adapter) as bus:
        for fault in (SensorFault.OPEN, None, SensorFault.OPEN):
            await bus.synchronise("other", 5, TPDOS)
            if fault:
                slow.faults.by_channel[0] = fault
            else:
                slow.faults.by_channel.clear()
            frames = await bus.synchronise("slow", 6, (0x186, 0x286))
            value, status = frames[0x186].data[:4], frames[0x286].data[0]
            assert (int.from_bytes(value, "little") > 800, status != 0) == (fault is not None,) * 2
