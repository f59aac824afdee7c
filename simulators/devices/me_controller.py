"""An emulated displacement controller on Ethernet that streams its values."""

import asyncio
import struct

from simulators.devices.source import Fault, Faults, ValueSource
from simulators.devices.spoil import Spoil, send

_FULL_SCALE = 0xFFFFFF
_ORDER, _SERIAL = 2303021, 1001


class MeController:
    """Sends a block of one frame to everybody connected, `rate_hz` times a second (real time).

    Its source gives distances in µm, 0 to `range_um`. `await start()` gives the port.
    """

    def __init__(self, source: ValueSource, *, range_um: float, rate_hz: float = 100.0) -> None:
        self._source, self._range_um, self._interval_s = source, range_um, 1.0 / rate_hz
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Transport] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._counter = 0
        self.faults = Faults()
        self.spoil: Spoil | None = None
        """What happens to blocks on the wire; the sender is 1."""

    async def start(self, port: int = 0) -> int:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self._clients), "127.0.0.1", port)
        self._timer = loop.call_later(self._interval_s, self._tick)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        if self._server is None or self._timer is None:
            return
        self._timer.cancel()
        self._server.close()
        for client in tuple(self._clients):
            client.abort()
        await self._server.wait_closed()
        self._server = self._timer = None
        await asyncio.sleep(0)

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._interval_s, self._tick)
        self._counter = (self._counter + 1) & 0xFFFFFFFF
        if self._clients and not self.faults.silent:
            frame = block([[self._raw(i, value) for i, value in enumerate(self._source())]], self._counter)
            for client in self._clients:
                send(client.write, self.spoil, 1, frame)

    def _raw(self, channel: int, distance_um: float) -> int:
        match self.faults.by_channel.get(channel):
            case Fault.OPEN | Fault.OVER:
                return _FULL_SCALE + 1000
            case Fault.SHORT | Fault.UNDER:
                return -1000
            case None:
                return round(distance_um / self._range_um * _FULL_SCALE)


class _Client(asyncio.Protocol):
    def __init__(self, clients: set[asyncio.Transport]) -> None:
        self._clients = clients
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            self._clients.add(transport)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's interface
        if self._transport is not None:
            self._clients.discard(self._transport)


def block(frames: list[list[int]], counter: int, *, skip: int = 0) -> bytes:
    """One block of frames with equally many values; the first `skip` channels are not fitted."""
    channels = len(frames[0])
    field = sum(1 << 2 * (skip + i) for i in range(channels))
    header = struct.pack("<4sIIQIHHI", b"MEAS", _ORDER, _SERIAL, field, 0, len(frames), 4 * channels, counter)
    return header + b"".join(struct.pack(f"<{channels}i", *frame) for frame in frames)
