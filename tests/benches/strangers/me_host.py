"""Micro-Epsilon controllers of somebody else: drawn from a seed, a few oddities at once, and played."""

import random
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tests.benches.strangers.driven_loop import DrivenLoop, Line
from tests.benches.strangers.nature import Told
from tests.benches.strangers.nature import log_uniform as _log

_HEADER = struct.Struct("<4sIIQIHHI")
_ENDS = (0, 0xFFFFFF)
_NUMBERS = 2**32


@dataclass(frozen=True)
class MeNature(Told):
    """How it behaves; what is 0, none or empty does not occur. Times are seconds, shares 0 to 1."""

    always = ("period_s", "timeout_s", "block_s")

    channels: int = 2
    period_s: float = 1.0
    timeout_s: float = 1.0
    block_s: float = 0.05
    """Between two blocks."""
    frames: int = 1
    """In each block, the newest one last."""
    # A connection.
    mute_s: float = 0.0
    """After a connection nothing is sent."""
    lingers_s: float = 0.0
    """It has one client, and notices so late that it has gone; a second one is refused, or never served."""
    second: str = "refused"
    closes_s: float = 0.0
    """After this time on one connection."""
    # Blocks.
    pieces_s: float = 0.0
    """Between the two parts in which a block comes."""
    loses: float = 0.0
    """Share of the blocks of which some bytes are lost, as of a buffer that overflows."""
    noise: float = 0.0
    """Share of the blocks with other bytes before them."""
    first_counter: int = 0
    counts: bool = True
    """Otherwise its counter is always 0."""
    # Every `every_s`, for `burst_s`:
    burst: str = ""
    """`silent`, `frozen` (counter and values stand still), `held` (what is measured is sent at the end), `restarts`,
    `low` or `high` (the last channel is at that end of its converter), `other` (another controller answers)."""
    burst_s: float = 0.0
    every_s: float = 30.0


def _burst(*kinds: str) -> Callable[[random.Random], Mapping[str, object]]:
    return lambda d: {"burst": d.choice(kinds), "burst_s": _log(d, 0.3, 8.0), "every_s": d.uniform(12, 40)}


_ODDITIES: tuple[Callable[[random.Random], Mapping[str, object]], ...] = (
    lambda d: {"block_s": _log(d, 0.02, 3.0)},
    lambda d: {"mute_s": _log(d, 0.05, 3.0)},
    lambda d: {"lingers_s": _log(d, 0.1, 5.0), "second": d.choice(("refused", "mute"))},
    lambda d: {"closes_s": _log(d, 0.1, 20.0)},
    lambda d: {"pieces_s": _log(d, 0.001, 0.1)},
    lambda d: {"loses": _log(d, 0.01, 0.5)},
    lambda d: {"noise": _log(d, 0.05, 1.0)},
    lambda _: {"counts": False},
    lambda d: {"first_counter": _NUMBERS - d.randrange(1, 200)},
    _burst("silent", "held", "restarts"),
    _burst("frozen", "frozen", "other"),
    _burst("low", "high"),
)


def drawn(draw: random.Random) -> MeNature:
    """One of them."""
    plain: dict[str, object] = {
        "channels": draw.choice((1, 2, 4)),
        "frames": draw.choice((1, 1, 5)),
        "period_s": draw.choice((0.5, 1.0, 1.0, 3.0)),
        "timeout_s": draw.choice((0.3, 0.5, 1.0)),
    }
    for _ in range(draw.choice((1, 1, 2, 3))):
        plain |= draw.choice(_ODDITIES)(draw)
    return MeNature(**plain)  # type: ignore[arg-type]


def count_of(channel: int, at_s: float) -> int:
    """What the channel's converter counts at that time: it says which channel it is, and when it was measured."""
    return channel + 1 << 20 | round(at_s * 100) % 2**20


def told(count: int) -> tuple[int, int]:
    """Channel, and hundredths of a second modulo 2**20."""
    return (count >> 20) - 1, count & 2**20 - 1


def age_s(count: int, now_s: float) -> float:
    """How long ago it was measured."""
    return (round(now_s * 100) - told(count)[1]) % 2**20 / 100


class ForeignController:
    """One controller, which sends whether it is asked or not."""

    def __init__(self, loop: DrivenLoop, nature: MeNature, draw: random.Random) -> None:
        self._loop, self._is, self._draw = loop, nature, draw
        self._began_s = loop.time()
        self._client: Line | None = None
        self._taken_until_s = 0.0
        self._counter = nature.first_counter
        self._block = b""
        """The newest one."""
        self._held: list[bytes] = []
        loop.call_later(nature.block_s, self._measure)

    @property
    def _in_burst(self) -> str:
        nature = self._is
        since_s = (self._loop.time() - self._began_s) % nature.every_s
        return nature.burst if nature.burst and since_s > nature.every_s - nature.burst_s else ""

    @property
    def refuses(self) -> bool:
        return self._in_burst == "restarts" or (self._is.second == "refused" and self._is_taken)

    @property
    def _is_taken(self) -> bool:
        return bool(self._is.lingers_s) and (self._client is not None or self._loop.time() < self._taken_until_s)

    def connected(self, line: Line) -> None:
        if self._is_taken:
            return
        self._client = line
        if self._is.closes_s:
            self._loop.call_later(self._is.closes_s, line.hang_up)

    def heard(self, line: Line, data: bytes) -> None:
        """It listens to nobody."""

    def left(self, line: Line) -> None:
        if line is self._client:
            self._client, self._taken_until_s = None, self._loop.time() + self._is.lingers_s

    def _measure(self) -> None:
        nature, now_s, burst = self._is, self._loop.time(), self._in_burst
        self._loop.call_later(nature.block_s, self._measure)
        if burst != "frozen" or not self._block:
            self._counter = (self._counter + nature.frames) % _NUMBERS if nature.counts else 0
            self._block = self._framed(now_s, burst)
        if burst == "restarts" and self._client is not None:
            self._client.hang_up()
            self._counter = 0
        line = self._client
        if line is None or now_s < line.opened_s + nature.mute_s or burst in ("silent", "restarts"):
            self._held.clear()
        elif burst == "held":
            self._held.append(self._block)
        else:
            for block in (*self._held, self._block):
                self._send(line, block)
            self._held.clear()

    def _framed(self, now_s: float, burst: str) -> bytes:
        nature = self._is
        serial = 4711 if burst != "other" else 4712
        counts = []
        for frame in range(nature.frames):
            at_s = now_s - (nature.frames - 1 - frame) * nature.block_s / nature.frames
            counts += [count_of(channel, at_s) for channel in range(nature.channels)]
            if burst in ("low", "high"):
                counts[-1] = _ENDS[burst == "high"]
        field = sum(1 << 2 * channel for channel in range(nature.channels))
        head = (b"MEAS", 2303008, serial, field, 0, nature.frames, 4 * nature.channels, self._counter)
        return _HEADER.pack(*head) + struct.pack(f"<{len(counts)}i", *counts)

    def _send(self, line: Line, block: bytes) -> None:
        nature, draw, now_s = self._is, self._draw, self._loop.time()
        if draw.random() < nature.loses:
            at = draw.randrange(len(block))
            block = block[:at] + block[at + draw.randrange(1, 9) :]
        if draw.random() < nature.noise:
            block = draw.randbytes(draw.randrange(1, 9)) + block
        if nature.pieces_s and len(block) > 1:
            at = draw.randrange(1, len(block))
            line.send(block[:at], now_s)
            line.send(block[at:], now_s + min(nature.pieces_s, 0.9 * nature.block_s))
        else:
            line.send(block, now_s)
