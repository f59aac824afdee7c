"""MQTT brokers and publishers of somebody else: drawn from a seed, a few oddities at once, and played.

Written from MQTT 3.1.1.
"""

import asyncio
import json
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from tests.benches.mqtt_packets import packet, received
from tests.benches.strangers.nature import Told
from tests.benches.strangers.nature import log_uniform as _log

_CONNECT, _SUBSCRIBE, _PING, _GOODBYE = 1, 8, 12, 14
_UNAVAILABLE = b"\x20\x02\x00\x03"


@dataclass(frozen=True)
class MqttNature(Told):
    """How it behaves; what is 0, none or empty does not occur. Times are seconds, shares 0 to 1."""

    always = ("period_s", "timeout_s", "interval_s")

    topics: int = 2
    timed: bool = False
    """Whether a message says when its value was measured."""
    period_s: float = 1.0
    timeout_s: float = 1.0
    interval_s: float = 0.5
    """Between two messages of a topic."""
    # A connection.
    mute_s: float = 0.0
    """After a connection it swallows what comes."""
    lingers_s: float = 0.0
    """It has one client, and notices so late that it has gone; a second one is refused, or never served."""
    second: str = "refused"
    closes_s: float = 0.0
    closes_after: int = 0
    """Messages on one connection."""
    # Messages.
    kept: bool = False
    """Whether it keeps the last one of each topic for who subscribes."""
    qos: int = 0
    twice: float = 0.0
    """Share of them that come twice."""
    overtaken: float = 0.0
    """Share of them that come after later ones."""
    pieces_s: float = 0.0
    """Between the two parts in which one comes; less where the line could not carry all that is measured."""
    clock_s: float = 0.0
    """The publisher's clock is ahead by so much."""
    # Every `every_s`, for `burst_s`:
    burst: str = ""
    """`silent`, `held` (what is measured is sent at the end), `frozen` (the same message comes again and again),
    `restarts`, `null` (a message has no number)."""
    burst_s: float = 0.0
    every_s: float = 30.0


def _burst(*kinds: str) -> Callable[[random.Random, MqttNature], Mapping[str, object]]:
    return lambda d, _: {"burst": d.choice(kinds), "burst_s": _log(d, 0.3, 8.0), "every_s": d.uniform(12, 40)}


_ODDITIES: tuple[Callable[[random.Random, MqttNature], Mapping[str, object]], ...] = (
    lambda d, n: {"interval_s": _log(d, 0.05, 2.0 * n.period_s)},
    lambda d, _: {"mute_s": _log(d, 0.05, 3.0)},
    lambda d, _: {"lingers_s": _log(d, 0.1, 5.0), "second": d.choice(("refused", "mute"))},
    lambda d, _: {"closes_s": _log(d, 0.1, 20.0)},
    lambda d, _: {"closes_after": d.choice((1, 3, 10, 30))},
    lambda _, __: {"kept": True},
    lambda _, __: {"qos": 1},
    lambda d, _: {"twice": _log(d, 0.05, 1.0)},
    lambda d, _: {"overtaken": _log(d, 0.05, 0.5)},
    lambda d, _: {"pieces_s": _log(d, 0.001, 0.1)},
    lambda d, n: {"clock_s": d.choice((-3600.0, -0.5, 0.5, 1.5, 3600.0)) * n.period_s},
    _burst("silent", "held", "restarts"),
    _burst("frozen", "null"),
)


def drawn(draw: random.Random) -> MqttNature:
    """One of them."""
    plain: dict[str, object] = {
        "topics": draw.choice((1, 2, 3)),
        "timed": draw.random() < 0.6,
        "period_s": draw.choice((0.5, 1.0, 1.0, 3.0)),
        "timeout_s": draw.choice((0.5, 1.0, 2.0)),
        "interval_s": 0.4,
    }
    for _ in range(draw.choice((1, 1, 2, 3))):
        plain |= draw.choice(_ODDITIES)(draw, MqttNature(**plain))  # type: ignore[arg-type]
    return MqttNature(**plain)  # type: ignore[arg-type]


def told(value: float) -> int:
    """The number of its topic."""
    return int(value) >> 24


def age_s(value: float, now_s: float) -> float:
    """How long ago it was measured."""
    return (round(now_s * 100) - int(value)) % 2**24 / 100


class ForeignBroker:
    """A broker, and who publishes there."""

    def __init__(self, nature: MqttNature, draw: random.Random) -> None:
        self._is, self._draw = nature, draw
        self._loop = asyncio.get_running_loop()
        self._began_s = self._loop.time()
        self._runs, self._number = True, 0
        self._writer: asyncio.StreamWriter | None = None
        """Of who has subscribed."""
        self._taken = False
        self._taken_until_s = 0.0
        self._latest: dict[int, bytes] = {}
        self._waiting: list[tuple[int, bytes]] = []
        self._sent_s = 0.0
        self._count = 0
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.StreamWriter] = set()

    async def start(self) -> int:
        """Its port."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        for topic in range(self._is.topics):
            self._loop.call_later(self._is.interval_s * (topic + 1) / self._is.topics, self._measure, topic)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        self._runs = False
        assert self._server is not None
        self._server.close()
        for writer in list(self._open):
            writer.close()
        await self._server.wait_closed()
        await asyncio.sleep(0.1)

    @property
    def _in_burst(self) -> str:
        nature, since_s = self._is, (self._loop.time() - self._began_s) % self._is.every_s
        return nature.burst if nature.burst and since_s > nature.every_s - nature.burst_s else ""

    @property
    def _is_taken(self) -> bool:
        return bool(self._is.lingers_s) and (self._taken or self._loop.time() < self._taken_until_s)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nature, opened_s, refused = self._is, self._loop.time(), self._is_taken
        self._open.add(writer)
        if refused and nature.second == "refused":
            writer.write(_UNAVAILABLE)
            writer.close()
        if nature.closes_s:
            self._loop.call_later(nature.closes_s, writer.close)
        self._taken |= not refused
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while not writer.is_closing():
                first, body = await received(reader)
                if refused or self._loop.time() < opened_s + nature.mute_s:
                    continue
                if self._in_burst == "restarts":
                    break
                self._answer(writer, first >> 4, body)
        self._open.discard(writer)
        if writer is self._writer:
            self._writer = None
        if not refused:
            self._taken, self._taken_until_s = False, self._loop.time() + nature.lingers_s
        writer.close()

    def _answer(self, writer: asyncio.StreamWriter, kind: int, body: bytes) -> None:
        if kind == _CONNECT:
            writer.write(b"\x20\x02\x00\x00")
        elif kind == _SUBSCRIBE:
            writer.write(packet(0x90, body[:2] + bytes([self._is.qos]) * len(list(_topics(body[2:])))))
            self._writer, self._count = writer, 0
            if self._is.kept:
                for topic, payload in self._latest.items():
                    self._send(topic, payload, kept=True)
        elif kind == _PING:
            writer.write(b"\xd0\x00")
        elif kind == _GOODBYE:
            writer.close()

    def _measure(self, topic: int) -> None:
        if not self._runs:
            return
        nature, burst, now_s = self._is, self._in_burst, self._loop.time()
        self._loop.call_later(nature.interval_s, self._measure, topic)
        if burst == "restarts":
            for writer in list(self._open):
                writer.close()
            self._latest.clear()
            return
        value = topic << 24 | round(now_s * 100) % 2**24
        at = datetime.now(UTC) + timedelta(seconds=nature.clock_s)
        payload = json.dumps({"v": value, "t": at.isoformat()} if nature.timed else {"v": value}).encode()
        if burst == "frozen" and topic in self._latest:
            payload = self._latest[topic]
        elif burst == "null":
            payload = json.dumps({"v": None, "t": at.isoformat()}).encode()
        self._latest[topic] = payload
        if burst == "silent":
            return
        if burst == "held":
            self._waiting.append((topic, payload))
            return
        waiting, self._waiting = self._waiting, []
        if self._draw.random() < nature.overtaken:
            self._loop.call_later(self._draw.uniform(0.5, 3.0) * nature.interval_s, self._send, topic, payload)
            return
        for one, text in (*waiting, (topic, payload)):
            self._send(one, text)

    def _send(self, topic: int, payload: bytes, *, kept: bool = False) -> None:
        nature, writer = self._is, self._writer
        if writer is None or writer.is_closing():
            return
        name = b"t%d" % topic
        self._number = self._number % 0xFFFF + 1
        number = self._number.to_bytes(2, "big") if nature.qos else b""
        data = packet(0x30 | nature.qos << 1 | kept, len(name).to_bytes(2, "big") + name + number + payload)
        for _ in range(1 + (self._draw.random() < nature.twice)):
            at_s = max(self._loop.time(), self._sent_s)
            if nature.pieces_s:
                cut = self._draw.randrange(1, len(data))
                self._loop.call_at(at_s, _write, writer, data[:cut])
                self._sent_s = at_s + min(nature.pieces_s, 0.4 * nature.interval_s / nature.topics)
                self._loop.call_at(self._sent_s, _write, writer, data[cut:])
                self._sent_s += 1e-4
            else:
                writer.write(data)
        self._count += 1
        if nature.closes_after and self._count >= nature.closes_after:
            self._loop.call_at(max(self._loop.time(), self._sent_s) + 0.001, writer.close)


def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    if not writer.is_closing():
        writer.write(data)


def _topics(body: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(body):
        end = at + 2 + int.from_bytes(body[at : at + 2], "big")
        yield body[at + 2 : end]
        at = end + 1
