"""Plays recorded devices on wires: a pseudo-terminal, a TCP port, an slcan adapter, a multicast group."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from simulators.devices.covered_reads import REQUEST_BYTES, TimedBytes, is_read
from simulators.devices.loopback import Connection, LoopbackServer
from simulators.devices.multicast_bus import MulticastBus
from simulators.devices.pty_port import PtyPort
from simulators.devices.script import HANG_UP, Script, frame_key, frame_of, numbered
from simulators.devices.slcan_adapter import CanFrame, SlcanAdapter

_MBAP = 7

Transmit = Callable[[bytes | None], None]


class _Requests:
    """The requests in a stream of bytes, recognised by comparison with the recorded ones."""

    def __init__(self, script: Script) -> None:
        self._script = script
        self._heard = b""

    def found(self, data: bytes) -> Iterator[bytes]:
        """The next ones; bytes that begin none of them are skipped."""
        self._heard += data
        while self._heard:
            request = next((r for r in self._script.answers if self._heard.startswith(r)), None)
            if request is not None:
                self._heard = self._heard[len(request) :]
                yield request
            elif self._script.is_rtu and is_read(self._heard[:REQUEST_BYTES]):
                request, self._heard = self._heard[:REQUEST_BYTES], self._heard[REQUEST_BYTES:]
                yield request
            elif any(r.startswith(self._heard) for r in self._script.answers):
                return
            else:
                self._script.unknown += 1
                self._heard = b""


class PlayedLine:
    """A recorded serial line. `await start()` gives the path of its pseudo-terminal."""

    def __init__(self, script: Script) -> None:
        self._script, self._requests = script, _Requests(script)
        self._port = PtyPort(self._on_bytes)
        self._timers = ScriptTimers()

    async def start(self) -> str:
        return await self._port.start()

    async def stop(self) -> None:
        self._timers.stop()
        await self._port.stop()

    def _on_bytes(self, data: bytes) -> None:
        for request in self._requests.found(data):
            self._timers.say(self._script.answer(request), self._say)

    def _say(self, data: bytes | None) -> None:
        if data is not HANG_UP:
            self._port.write(data)


class PlayedHost:
    """A recorded TCP connection; `await start()` gives the loopback port. Every connection gets the same script.

    numbered: Modbus TCP, whose answers carry the number of their request
    """

    def __init__(self, script: Script, *, numbered: bool) -> None:
        self.server = LoopbackServer(lambda: _PlayedConnection(script, numbered))

    async def start(self, port: int = 0) -> int:
        return await self.server.start(port)

    async def stop(self) -> None:
        await self.server.stop()


class _PlayedConnection(Connection):
    def __init__(self, script: Script, with_numbers: bool) -> None:
        super().__init__()
        self._script, self._requests, self._numbered = script, _Requests(script), with_numbers
        self._timers = ScriptTimers()
        self._heard = b""
        self._rest = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self.transport is not None:
            self._timers.repeat(self._script, partial(self._say, 0))

    def connection_lost(self, exc: Exception | None) -> None:
        self._timers.stop()
        super().connection_lost(exc)

    def abort(self) -> None:
        self._timers.stop()
        super().abort()

    def data_received(self, data: bytes) -> None:
        if not self._numbered:
            for request in self._requests.found(data):
                self._timers.say(self._script.answer(request), partial(self._say, 0))
            return
        self._heard += data
        while len(self._heard) >= _MBAP and len(self._heard) >= 6 + int.from_bytes(self._heard[4:6], "big"):
            size = 6 + int.from_bytes(self._heard[4:6], "big")
            request, self._heard = self._heard[:size], self._heard[size:]
            number = int.from_bytes(request[:2], "big")
            self._timers.say(self._script.answer(bytes(2) + request[2:]), partial(self._say, number))

    def _say(self, number: int, data: bytes | None) -> None:
        if self.transport is None or self.transport.is_closing():
            return
        if data is HANG_UP:
            self.transport.close()
            return
        if self._numbered:
            data, self._rest = numbered(data, number, self._rest)
        self.transport.write(data)


class PlayedAdapter:
    """A recorded CAN bus behind an slcan adapter. `await start()` gives the path of its pseudo-terminal."""

    def __init__(self, script: Script) -> None:
        self._script = script
        self._adapter = SlcanAdapter([self])
        self._timers = ScriptTimers()

    async def start(self) -> str:
        path = await self._adapter.start()
        self._timers.repeat(self._script, self._say)
        return path

    async def stop(self) -> None:
        self._timers.stop()
        await self._adapter.stop()

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        """The answers to this frame as a node on the adapter's bus, with their recorded delays."""
        self._timers.say(self._script.answer(frame_key(identifier, data)), self._say)
        return ()

    def _say(self, data: bytes | None) -> None:
        if data is not None:
            self._adapter.send([frame_of(data)])


class PlayedGroup:
    """A recorded CAN bus on a UDP multicast group of this computer, for any number of readers."""

    def __init__(self, script: Script, group: str, port: int) -> None:
        self._script = script
        self._bus = MulticastBus([self], group, port)
        self._timers = ScriptTimers()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._said: Counter[bytes] = Counter()

    async def start(self) -> None:
        """Raises OSError when the group cannot be joined."""
        self._loop = asyncio.get_running_loop()
        self._bus.start()
        self._timers.repeat(self._script, self._say)

    async def stop(self) -> None:
        self._timers.stop()
        await asyncio.to_thread(self._bus.stop)

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        """Runs in the bus's thread: the event loop sends the answer."""
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._heard, frame_key(identifier, data))
        return ()

    def _heard(self, frame: bytes) -> None:
        if self._said[frame]:  # what we send comes back
            self._said[frame] -= 1
        else:
            self._timers.say(self._script.answer(frame), self._say)

    def _say(self, data: bytes | None) -> None:
        if data is not None:
            self._said[data] += 1
            self._bus.send([frame_of(data)])


class ScriptTimers:
    """The answers that are still to be sent, on the event loop's time."""

    def __init__(self) -> None:
        self._waiting: set[asyncio.TimerHandle] = set()

    def say(self, said: Sequence[TimedBytes], to: Transmit) -> None:
        """Each after its delay; without delay at once, in order."""
        for delay_s, data in said:
            self._later(delay_s, to, data)

    def repeat(self, script: Script, to: Transmit) -> None:
        """Sends the unasked messages, over and over."""
        if not script.unasked:
            return
        self.say(script.unasked, to)
        period_s = max(script.lasts_s, script.unasked[-1][0] + 0.001)
        self._after(period_s, lambda: self.repeat(script, to))

    def stop(self) -> None:
        """Send nothing more."""
        for timer in self._waiting:
            timer.cancel()
        self._waiting.clear()

    def _later(self, delay_s: float, to: Transmit, data: bytes | None) -> None:
        self._after(delay_s, lambda: to(data))

    def _after(self, delay_s: float, what: Callable[[], None]) -> None:
        def due() -> None:
            self._waiting.discard(timer)
            what()

        timer = asyncio.get_running_loop().call_later(delay_s, due)
        self._waiting.add(timer)
