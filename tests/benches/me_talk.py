"""A displacement sensor's RS-485 line whose answers the test supplies."""

import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.micro_epsilon.rs485 import MeRs485Bus
from drivers.micro_epsilon.settings import MeRs485Settings
from simulators.devices.pty_port import PtyPort


def value(data: bytes) -> float:
    return float(struct.unpack("<ff", data)[0])


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
