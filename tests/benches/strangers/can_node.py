"""What a CANopen node of somebody else is like, drawn from a seed, and plays it."""

import random
import struct
from asyncio import AbstractEventLoop
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from simulators.devices.slcan_adapter import CanFrame
from tests.benches.strangers.nature import Told
from tests.benches.strangers.nature import log_uniform as _log

OBJECTS = ((0x2100, 1), (0x2100, 2), (0x2101, 0))
"""Index and subindex of each; the last one has eight bytes, which come in segments."""
_LONG = 2
_ABSENT, _STATE = 0x06020000, 0x08000022
_BOOTS_S = 0.5
_BEAT_S = 0.25


@dataclass(frozen=True)
class CanNature(Told):
    """How it behaves; what is 0, none or empty does not occur. Times are seconds, shares 0 to 1."""

    transfer: str = "sdo"
    neighbour: bool = False
    """Whether an honest node is on the bus too."""
    objects: int = 1
    period_s: float = 1.0
    timeout_s: float = 0.2
    took_s: float = 0.001
    jitter_s: float = 0.0
    slower: float = 0.0
    """Share of the answers that take `slower_s` longer."""
    slower_s: float = 0.0
    rest_s: float = 0.0
    """What comes sooner after an answer is ignored."""
    swallows: float = 0.0
    burst: str = ""
    """What it does for `burst_s`, every `every_s`: `off`, and boots afterwards; `silent`; `refuses`."""
    burst_s: float = 0.0
    every_s: float = 30.0
    twice: float = 0.0
    """Share of the answers and TPDOs that come twice."""
    uncounted: bool = False
    """Whether its answers do not say how many bytes they have."""
    serial: bool = True
    """Whether it has a serial number."""
    beats: str = "right"
    """Its heartbeat: `right`, `none`, `never`: it states one that does not come."""
    babbles: float = 0.0
    """How often a second it sends an emergency or a frame of no meaning."""
    event_s: float = 0.0
    """Of its TPDO's timer."""


_ODD: tuple[Callable[[random.Random, CanNature], Mapping[str, object]], ...] = (
    lambda d, n: {"took_s": _log(d, 0.01, max(0.02, 0.5 * n.period_s / (n.objects + 3)))},
    lambda d, n: {"took_s": _log(d, 0.01, max(0.02, 0.5 * n.period_s / (n.objects + 3)))},
    lambda d, _: {"jitter_s": _log(d, 0.005, 0.1)},
    lambda d, n: {"slower": _log(d, 0.02, 0.3), "slower_s": _log(d, 0.05, n.period_s)},
    lambda d, _: {"rest_s": _log(d, 0.001, 0.05)},
    lambda d, _: {"swallows": _log(d, 0.01, 0.2)},
    lambda d, _: {
        "burst": d.choice(("off", "silent", "refuses")),
        "burst_s": _log(d, 0.3, 8.0),
        "every_s": d.uniform(12, 40),
    },
    lambda d, _: {"twice": _log(d, 0.05, 1.0)},
    lambda _, __: {"uncounted": True},
    lambda d, _: {"beats": d.choice(("none", "never"))},
    lambda _, __: {"serial": False},
    lambda d, _: {"babbles": _log(d, 0.5, 50.0)},
)


def drawn(draw: random.Random) -> CanNature:
    """One of them."""
    transfer = draw.choice(("sdo", "sdo", "sync", "timer"))
    plain: dict[str, object] = {
        "transfer": transfer,
        "neighbour": draw.random() < 0.5,
        "objects": draw.choice((1, 2, 3)) if transfer == "sdo" else draw.choice((1, 2)),
        "period_s": draw.choice((0.5, 1.0, 1.0, 3.0)),
        "timeout_s": draw.choice((0.1, 0.2, 0.5)),
    }
    if transfer == "timer":
        plain["event_s"] = round(float(str(plain["timeout_s"])) * draw.choice((0.2, 0.5, 0.8)), 3)
    for _ in range(draw.choice((1, 1, 2, 2, 3))):
        plain |= draw.choice(_ODD)(draw, CanNature(**plain))  # type: ignore[arg-type]
    return CanNature(**plain)  # type: ignore[arg-type]


def word(node: int, number: int, at_s: float) -> int:
    """What the object of this number holds: node, number, and when it was measured."""
    return (node & 7) << 28 | number << 24 | round(at_s * 100) % 2**24


def told(held: int) -> tuple[int, int]:
    """Node and number."""
    return held >> 28 & 7, held >> 24 & 15


def age_s(held: int, now_s: float) -> float:
    """How long ago it was measured."""
    return (round(now_s * 100) - held % 2**24) % 2**24 / 100


class ForeignNode:
    """One node; `send` puts frames on the bus."""

    def __init__(self, loop: AbstractEventLoop, node: int, nature: CanNature, draw: random.Random) -> None:
        self._loop, self.node, self._is, self._draw = loop, node, nature, draw
        self.send: Callable[[Sequence[CanFrame]], None] = lambda _: None
        self._began_s = self._free_s = loop.time()
        self._answered_s = -1e9
        self._left, self._toggle = b"", 0
        self._operational = self._was_off = False
        self._runs = True
        loop.call_later(0.0, self._beat)
        if nature.babbles:
            loop.call_later(draw.expovariate(nature.babbles), self._babble)
        if nature.event_s:
            loop.call_later(nature.event_s, self._timed)

    def stop(self) -> None:
        self._runs = False

    @property
    def _burst(self) -> str:
        nature, phase_s = self._is, (self._loop.time() - self._began_s) % self._is.every_s
        if nature.burst == "off" and self._was_off and phase_s < _BOOTS_S:
            return "off"
        return nature.burst if phase_s > nature.every_s - nature.burst_s else ""

    def _beat(self) -> None:
        if not self._runs:
            return
        off = self._burst == "off"
        if self._was_off and not off:
            self._operational, self._left = False, b""
            self.send([(0x700 + self.node, b"\0")])
        self._was_off = off
        if self._is.beats == "right" and not off:
            self.send([(0x700 + self.node, bytes((5 if self._operational else 127,)))])
        self._loop.call_later(_BEAT_S, self._beat)

    def _babble(self) -> None:
        if not self._runs:
            return
        emergency = 0x80 + self.node, struct.pack("<HB5x", 0x1000, 1)
        self.send([self._draw.choice((emergency, (0x7E5, b"x"), (1 << 31 | 0x12345, b"12"), (0x580 + 99, bytes(8))))])
        self._loop.call_later(self._draw.expovariate(self._is.babbles), self._babble)

    def _timed(self) -> None:
        if not self._runs:
            return
        if self._operational and not self._burst:
            self._put(0x180 + self.node, self._mapped())
        self._loop.call_later(self._is.event_s, self._timed)

    def _mapped(self) -> bytes:
        now_s = self._loop.time()
        return b"".join(word(self.node, i, now_s).to_bytes(4, "little") for i in range(min(2, self._is.objects)))

    def _put(self, identifier: int, data: bytes) -> None:
        self.send([(identifier, data)])
        if self._draw.random() < self._is.twice:
            self._loop.call_later(self._draw.uniform(0.0005, 0.02), self._again, identifier, data)

    def _again(self, identifier: int, data: bytes) -> None:
        self.send([(identifier, data)])

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        """A frame of another; it answers later."""
        nature, now_s, draw = self._is, self._loop.time(), self._draw
        if self._burst in ("off", "silent"):
            return ()
        if identifier == 0 and data[:1] == b"\1" and data[1] in (0, self.node):
            self._operational = True
        elif identifier == 0x80 and nature.transfer == "sync" and self._operational:
            if draw.random() >= nature.swallows:
                self._loop.call_later(self._takes_s(), self._synchronous)
        elif identifier == 0x600 + self.node and len(data) == 8 and data[0] != 0x80:
            if draw.random() < nature.swallows or now_s < self._answered_s + nature.rest_s:
                return ()
            self._free_s = max(now_s, self._free_s) + self._takes_s()
            self._loop.call_at(self._free_s, self._answer, data)
        return ()

    def _synchronous(self) -> None:
        if self._runs and not self._burst:
            self._put(0x180 + self.node, self._mapped())

    def _takes_s(self) -> float:
        nature, draw = self._is, self._draw
        slower_s = nature.slower_s if draw.random() < nature.slower else 0.0
        return nature.took_s + draw.random() * nature.jitter_s + slower_s

    def _answer(self, request: bytes) -> None:
        if not self._runs or self._burst in ("off", "silent"):
            return
        self._answered_s = self._loop.time()
        self._put(0x580 + self.node, self._answered(request))

    def _answered(self, request: bytes) -> bytes:
        if request[0] & 0xE0 == 0x60:
            if not self._left:
                return b"\x80" + bytes(3) + struct.pack("<I", _STATE)
            part, self._left = self._left[:7], self._left[7:]
            return bytes((request[0] & 0x10 | 7 - len(part) << 1 | (not self._left),)) + part.ljust(7, b"\0")
        place = struct.unpack_from("<HB", request, 1)
        self._left = b""
        if (held := self._held(place)) is None or (self._burst == "refuses" and place in OBJECTS):
            return b"\x80" + request[1:4] + struct.pack("<I", _ABSENT if held is None else _STATE)
        if len(held) <= 4:
            counted = not self._is.uncounted or len(held) < 4
            return bytes((0x43 | 4 - len(held) << 2 if counted else 0x42,)) + request[1:4] + held.ljust(4, b"\0")
        self._left = held
        return b"\x41" + request[1:4] + struct.pack("<I", len(held))

    def _held(self, place: tuple[int, int]) -> bytes | None:
        nature, now_s = self._is, self._loop.time()
        if place in OBJECTS[: nature.objects]:
            number = OBJECTS.index(place)
            return word(self.node, number, now_s).to_bytes(8 if number == _LONG else 4, "little")
        mapping = {
            (0x1A00, 0): bytes((min(2, nature.objects),)),
            (0x1A00, 1): struct.pack("<I", 0x2100_01_20),
            (0x1A00, 2): struct.pack("<I", 0x2100_02_20),
            (0x1800, 1): struct.pack("<I", 0x180 + self.node),
            (0x1800, 2): b"\x01" if nature.transfer == "sync" else b"\xff",
            (0x1800, 5): struct.pack("<H", round(1e3 * nature.event_s)),
        }
        held = {
            (0x1000, 0): bytes(4),
            (0x1001, 0): b"\0",
            (0x1017, 0): struct.pack("<H", 0 if nature.beats == "none" else round(1e3 * _BEAT_S)),
            (0x1018, 0): b"\x04" if nature.serial else b"\x01",
            **({(0x1018, 4): struct.pack("<I", 7)} if nature.serial else {}),
            **(mapping if nature.transfer != "sdo" else {}),
        }
        return held.get(place)
