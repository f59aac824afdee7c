"""Boot-up messages, heartbeats and emergencies of a CANopen node (CiA 301), in bounded memory whatever it sends."""

import struct
from dataclasses import dataclass
from time import monotonic

_EMERGENCY = struct.Struct("<HB")
_BOOT_UP = 0


@dataclass(frozen=True, slots=True)
class Emergency:
    """An active emergency."""

    code: int
    register: int
    """Error register, object 1001."""

    def __str__(self) -> str:
        return f"emergency 0x{self.code:04X}, error register 0x{self.register:02X}"


class NodeEvents:
    """The latest events of one node. The receiving thread writes, others read; every write is a single assignment."""

    def __init__(self) -> None:
        self.emergency: Emergency | None = None
        """The last emergency that the node has not cleared."""
        self.boots = 0
        """How often the node has started since listening began."""
        self.heard_s: float | None = None
        """Monotonic seconds of its last heartbeat or boot-up."""

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

    def begin(self, limit_s: float, now_s: float) -> None:
        """Expect a heartbeat within `limit_s` of now, then of each other; 0: expect none.

        A lost heartbeat stays lost until one is received, however often the node is connected.
        """
        self._limit_s = limit_s
        if not self._lost:
            self._since_s = now_s

    def silent_s(self, now_s: float) -> float | None:
        """How long no heartbeat has come if that is too long, else None."""
        silent_s = now_s - max(self._since_s, self._events.heard_s or 0.0)
        self._lost = 0.0 < self._limit_s < silent_s
        return silent_s if self._lost else None
