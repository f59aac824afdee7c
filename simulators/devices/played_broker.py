"""Plays the recorded messages of an MQTT broker. Written from MQTT 3.1.1, independently of any client's code."""

import asyncio
from collections.abc import Iterator, Sequence
from enum import IntEnum

from simulators.devices.loopback import Connection, LoopbackServer
from simulators.devices.playback import ScriptTimers
from simulators.devices.script import Script

_CONNECTED, _SUBSCRIBED, _PONG = b"\x20\x02\x00\x00", 0x90, b"\xd0\x00"
_RETAINED = 0x01
_SHORTEST_S = 1.0
"""A shorter recording is not repeated more often than this."""


class _Kind(IntEnum):
    """Kind of a client's packet."""

    CONNECT = 1
    SUBSCRIBE = 8
    PING = 12
    DISCONNECT = 14


class PlayedBroker:
    """A recorded MQTT broker; `await start()` gives the loopback port.

    Each client receives the messages of the topics to which it subscribes, at their recorded times, again and again;
    those that the broker had kept, only once. Every client is let in. Nothing can be published.
    """

    def __init__(self, script: Script) -> None:
        self.server = LoopbackServer(lambda: _PlayedSubscriber(script))

    async def start(self, port: int = 0) -> int:
        return await self.server.start(port)

    async def stop(self) -> None:
        await self.server.stop()


class _PlayedSubscriber(Connection):
    def __init__(self, script: Script) -> None:
        super().__init__()
        kept = [(at_s, data) for at_s, data in script.unasked if _is_kept(data)]
        news = [(at_s, data) for at_s, data in script.unasked if not _is_kept(data)]
        self._kept, self._news = kept, Script({}, news, max(_SHORTEST_S, script.lasts_s))
        self._timers = ScriptTimers()
        self._filters: list[list[str]] = []
        self._heard = b""

    def connection_lost(self, exc: Exception | None) -> None:
        self._timers.stop()
        super().connection_lost(exc)

    def abort(self) -> None:
        self._timers.stop()
        super().abort()

    def data_received(self, data: bytes) -> None:
        self._heard += data
        while self.transport is not None and (found := _split(self._heard)) is not None:
            kind, body, self._heard = found
            match kind >> 4:
                case _Kind.CONNECT:
                    self.transport.write(_CONNECTED)
                case _Kind.SUBSCRIBE:
                    self._subscribe(self.transport, body)
                case _Kind.PING:
                    self.transport.write(_PONG)
                case _Kind.DISCONNECT:
                    self.transport.close()

    def _subscribe(self, transport: asyncio.Transport, body: bytes) -> None:
        first = not self._filters
        wanted = list(_filters(body))
        self._filters += wanted
        granted = body[:2] + bytes(len(wanted))
        transport.write(bytes((_SUBSCRIBED, len(granted))) + granted)
        if first:
            self._timers.say(self._kept, self._say)
            self._timers.repeat(self._news, self._say)

    def _say(self, packet: bytes | None) -> None:
        if packet is None or self.transport is None or self.transport.is_closing():
            return
        levels = _topic(packet).split("/")
        if any(_matches(wanted, levels) for wanted in self._filters):
            self.transport.write(packet)


def _split(heard: bytes) -> tuple[int, bytes, bytes] | None:
    """First byte and body of the first packet, and what follows it; None: it is not complete."""
    length = 0
    for at, byte in enumerate(heard[1:5]):
        length |= (byte & 0x7F) << 7 * at
        if byte < 0x80:
            end = 2 + at + length
            return (heard[0], heard[2 + at : end], heard[end:]) if len(heard) >= end else None
    return None


def _filters(body: bytes) -> Iterator[list[str]]:
    """The levels of each topic filter of a SUBSCRIBE packet."""
    at = 2
    while at + 2 < len(body):
        end = at + 2 + int.from_bytes(body[at : at + 2], "big")
        yield body[at + 2 : end].decode(errors="replace").split("/")
        at = end + 1


def _topic(packet: bytes) -> str:
    """The topic of a recorded message."""
    found = _split(packet)
    body = b"" if found is None else found[1]
    return body[2 : 2 + int.from_bytes(body[:2], "big")].decode(errors="replace")


def _is_kept(packet: bytes | None) -> bool:
    """Whether the broker had kept this message."""
    return packet is not None and bool(packet[0] & _RETAINED)


def _matches(wanted: Sequence[str], levels: Sequence[str]) -> bool:
    """Whether the filter names this topic; + stands for one level, # at the end for any number, also none."""
    for at, want in enumerate(wanted):
        if want == "#":
            return True
        if at >= len(levels) or want not in ("+", levels[at]):
            return False
    return len(wanted) == len(levels)
