"""A Modbus RTU line whose answers a test supplies."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.settings import ModbusRtuSettings
from simulators.devices.modbus_servers import crc16
from simulators.devices.pty_port import PtyPort

TIMEOUT_S = 0.1
TWO = Block(4, 0, 2)


def frame(body: bytes) -> bytes:
    return body + crc16(body)


def registers(unit: int, *words: int) -> bytes:
    return frame(bytes((unit, 4, 2 * len(words))) + b"".join(word.to_bytes(2, "big") for word in words))


class RtuPeer:
    """The other end of the line, played by the test: it answers each request with what `reply` makes of it."""

    def __init__(self) -> None:
        self.requests: list[bytes] = []
        self.is_asked = asyncio.Event()
        """There is a request. Simulated time waits for the wire while a test awaits this, and goes on if it polls."""
        self.path = ""
        self.reply: Callable[[bytes], bytes] = lambda _: b""
        self.port = PtyPort(self._on_bytes)

    def _on_bytes(self, data: bytes) -> None:
        for start in range(0, len(data), 8):
            self.requests.append(data[start : start + 8])
            self.is_asked.set()
            if answer := self.reply(self.requests[-1]):
                self.port.write(answer)


def honest(request: bytes, first: int = 100) -> bytes:
    """The answer of a device with registers first, first + 1, ..."""
    count = int.from_bytes(request[4:6], "big")
    return registers(request[0], *range(first, first + count))


@asynccontextmanager
async def line(timeout_s: float = TIMEOUT_S) -> AsyncIterator[tuple[ModbusRtuBus, RtuPeer]]:
    peer = RtuPeer()
    peer.path = await peer.port.start()
    bus = ModbusRtuBus("bus1", ModbusRtuSettings(port=peer.path, baud=115200, timeout_s=timeout_s))
    try:
        await bus.connect()
        yield bus, peer
    finally:
        await bus.close()
        await peer.port.stop()
