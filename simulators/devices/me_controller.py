"""An emulated displacement controller on Ethernet that streams its values."""

import asyncio
import struct

from simulators.devices.loopback import Connection, LoopbackServer
from simulators.devices.source import Faults, SensorFault, ValueSource
from simulators.devices.spoil import Spoil, send

_FULL_SCALE = 0xFFFFFF
_ORDER, _SERIAL = 2303021, 1001


class MeController:
    """Sends a block of one frame to every client, `rate_hz` times a second (real time).

    Its source gives distances in µm, 0 to `range_um`. `await start()` gives the port.
    """

    def __init__(self, source: ValueSource, *, range_um: float, rate_hz: float = 100.0) -> None:
        self._source, self._range_um, self._interval_s = source, range_um, 1.0 / rate_hz
        self.server = LoopbackServer(Connection)
        self._timer: asyncio.TimerHandle | None = None
        self._counter = 0
        self.serial = _SERIAL
        self.frozen = False
        """Whether it sends its last block again and again."""
        self._last: list[int] = []
        self.faults = Faults()
        self.spoil: Spoil | None = None
        """What happens to blocks on the wire; the sender is 1."""

    async def start(self, port: int = 0) -> int:
        number = await self.server.start(port)
        self._timer = asyncio.get_running_loop().call_later(self._interval_s, self._tick)
        return number

    async def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        await self.server.stop()

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._interval_s, self._tick)
        if not (self.frozen and self._last):
            self._counter = (self._counter + 1) & 0xFFFFFFFF
            self._last = [self._raw(i, value) for i, value in enumerate(self._source())]
        if self.server.connections and not self.faults.silent:
            frame = block([self._last], self._counter, serial=self.serial)
            for client in self.server.connections:
                if client.transport is not None and not client.forgotten:
                    send(client.transport.write, self.spoil, 1, frame)

    def _raw(self, channel: int, distance_um: float) -> int:
        match self.faults.by_channel.get(channel):
            case SensorFault.OPEN | SensorFault.OVER:
                return _FULL_SCALE
            case SensorFault.SHORT | SensorFault.UNDER:
                return 0
            case None:
                return round(distance_um / self._range_um * _FULL_SCALE)


def block(frames: list[list[int]], counter: int, *, skip: int = 0, serial: int = _SERIAL) -> bytes:
    """One block of frames with equally many values; the first `skip` channels are not fitted."""
    channels = len(frames[0])
    field = sum(1 << 2 * (skip + i) for i in range(channels))
    header = struct.pack("<4sIIQIHHI", b"MEAS", _ORDER, serial, field, 0, len(frames), 4 * channels, counter)
    return header + b"".join(struct.pack(f"<{channels}i", *frame) for frame in frames)
