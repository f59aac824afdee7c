"""Boot-up messages, heartbeats and emergencies of a CANopen node (CiA 301), in bounded memory whatever it sends."""

import struct
from collections import deque
from dataclasses import dataclass
from time import monotonic

from drivers.faults import Fault
from drivers.text import Text

_EMERGENCY = struct.Struct("<HB")
_BOOT_UP = 0
_BEATS = 12
"""How many intervals in a row must be short, and as many before them, until heartbeats count as those of two nodes: a
busy computer may receive some at once."""
_SHORT = 0.7
"""What share of the stated time they then take; of two nodes it is half."""


@dataclass(frozen=True, slots=True)
class Emergency:
    """An active emergency."""

    code: int
    register: int
    """Error register, object 1001."""

    @property
    def text(self) -> Text:
        return Text("emergency", code=self.code, register=self.register)


class NodeEvents:
    """The latest events of one node. The receiving thread writes, others read; every write is a single assignment."""

    def __init__(self) -> None:
        self.emergency: Emergency | None = None
        """The last emergency that the node has not cleared."""
        self.boots = 0
        """How often the node has started since listening began."""
        self.heard_s: float | None = None
        """Monotonic seconds of its last heartbeat or boot-up."""
        self.beats: deque[float] = deque(maxlen=2 * _BEATS + 1)
        """Monotonic seconds of its last heartbeats, boot-ups not counted."""

    def with_emergency(self, fault: Fault) -> Fault:
        """The fault, with the emergency that the node reports."""
        if self.emergency is None:
            return fault
        said = Text("canopen_emergency", detail=fault.detail, emergency=self.emergency.text)
        return Fault(fault.quality, said)

    def on_emergency(self, can_id: int, data: bytes | bytearray, timestamp: float) -> None:  # noqa: ARG002
        """Callback for frames 0x80 + node. A code 00xx clears emergencies; a short frame is ignored."""
        if len(data) >= _EMERGENCY.size:
            code, register = _EMERGENCY.unpack_from(data)
            self.emergency = Emergency(code, register) if code & 0xFF00 else None

    def on_heartbeat(self, can_id: int, data: bytes | bytearray, timestamp: float) -> None:  # noqa: ARG002
        """Callback for frames 0x700 + node; a frame without a state is ignored."""
        if len(data):
            self.heard_s = monotonic()
        if bytes(data[:1]) == bytes([_BOOT_UP]):
            self.boots += 1
            self.emergency = None
        elif len(data):
            self.beats.append(monotonic())


class HeartbeatWatch:
    """Whether a node's heartbeat arrives in time, judged on request.

    Ask after an answer from the node was received: frames arrive in order, so every heartbeat sent before that answer
    is known by then, and a busy computer does not mistake a live node for a lost one.
    """

    def __init__(self, events: NodeEvents) -> None:
        self._events = events
        self._limit_s = 0.0
        self._since_s = 0.0
        self._lost = False
        self._demanded = False
        self._producer_s = 0.0

    def begin(self, limit_s: float, now_s: float, *, demanded: bool = True, producer_s: float = 0.0) -> None:
        """Expect a heartbeat within `limit_s` of now, then of each other; 0: expect none.

        A lost heartbeat stays lost until one is received, however often the node is connected.

        demanded: also if none has ever come; otherwise a node that only states that it sends them is not watched
        producer_s: time from one to the next, as the node states it; 0: it states none
        """
        self._limit_s, self._demanded = limit_s, demanded
        self._producer_s = producer_s
        if not self._lost:
            self._since_s = now_s

    def silent_s(self, now_s: float) -> float | None:
        """How long no heartbeat has come if that is too long, else None."""
        if not (self._demanded or self._events.beats):
            return None
        silent_s = now_s - max(self._since_s, self._events.heard_s or 0.0)
        self._lost = 0.0 < self._limit_s < silent_s
        return silent_s if self._lost else None

    def never_came_s(self, now_s: float) -> float:
        """The time that the node states from one heartbeat to the next, if none has come for as long as is expected; 0:
        one has, or may still."""
        if self._demanded or self._events.beats or now_s - self._since_s < self._limit_s:
            return 0.0
        return self._producer_s

    @property
    def doubled(self) -> bool:
        """Whether heartbeats come about twice as often as the node states: two nodes have its id."""
        beats = tuple(self._events.beats)
        if len(beats) <= 2 * _BEATS or not self._producer_s:
            return False
        parts = beats[_BEATS] - beats[0], beats[-1] - beats[_BEATS]
        return max(parts) < _SHORT * _BEATS * self._producer_s
