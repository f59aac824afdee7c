"""What a CANopen node says unasked: boot-up and emergencies (CiA 301). Bounded, whatever the node sends."""

import struct
from dataclasses import dataclass

_EMERGENCY = struct.Struct("<HB")
_BOOT_UP = 0


@dataclass(frozen=True, slots=True)
class Emergency:
    """An emergency in force."""

    code: int
    register: int
    """Error register, object 1001."""

    def __str__(self) -> str:
        return f"emergency 0x{self.code:04X}, error register 0x{self.register:02X}"


class NodeEvents:
    """The latest news of one node. Written by the receiving thread, read by others; single assignments only."""

    def __init__(self) -> None:
        self.emergency: Emergency | None = None
        """The last emergency that the node has not taken back."""
        self.boots = 0
        """How often the node has started since we listen."""

    def on_emergency(self, can_id: int, data: bytes | bytearray, timestamp: float) -> None:  # noqa: ARG002
        """Callback for frames 0x80 + node. A code 00xx takes emergencies back; a short frame is none."""
        if len(data) >= _EMERGENCY.size:
            code, register = _EMERGENCY.unpack_from(data)
            self.emergency = Emergency(code, register) if code & 0xFF00 else None

    def on_heartbeat(self, can_id: int, data: bytes | bytearray, timestamp: float) -> None:  # noqa: ARG002
        """Callback for frames 0x700 + node."""
        if bytes(data[:1]) == bytes([_BOOT_UP]):
            self.boots += 1
            self.emergency = None
