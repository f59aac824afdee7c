"""A CANopen bus whose node answers whatever a test wants."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from simulators.devices import SlcanAdapter
from simulators.devices.slcan_adapter import CanNode
from tests.benches.buses import make_bus

NODE = 5
VALUE = CanObject(0x9130, 1)


@asynccontextmanager
async def talking(node: CanNode, timeout_s: float = 0.3) -> AsyncIterator[tuple[CanOpenBus, SlcanAdapter]]:
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": timeout_s})
    assert isinstance(bus, CanOpenBus)
    try:
        await bus.connect()
        yield bus, adapter
    finally:
        await bus.close()
        await adapter.stop()
