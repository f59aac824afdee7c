"""Survey of a CAN bus: frames heard without a request, then the device type (object 1000) of every CANopen node.

Blocks, so run it in a separate thread. It sends nothing but SDO upload requests, and nothing at all while it listens.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic, sleep
from types import TracebackType
from typing import Self

import can

from drivers.base import ConnectError
from drivers.can.interface import interface_error, open_interface, shut
from drivers.can.settings import CanInterfaceSettings
from drivers.can.wanted import FrameId
from drivers.text import Text

_SLICE_S = 0.05
"""How long stopping may take."""
_UPLOAD_DEVICE_TYPE = bytes.fromhex("40 00 10 00 00 00 00 00")
_AT_ONCE = 16
"""Number of nodes that are asked before their answers are read."""
_FRAME_BITS = 130
"""Bits of a frame with 8 data bytes, stuff bits included."""
_STATES = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}

Stopped = Callable[[], bool]
"""Called between two requests: True ends the survey or scan."""


@dataclass(slots=True)
class Heard:
    """What was received while listening or asking."""

    seconds: float = 0.0
    frames: Counter[FrameId] = field(default_factory=Counter)
    error_frames: int = 0
    states: dict[int, str] = field(default_factory=dict)
    """Node to its last boot-up or heartbeat, in words."""
    emergencies: dict[int, int] = field(default_factory=dict)
    """Node to the error code of its last emergency."""
    device_types: dict[int, int | None] = field(default_factory=dict)
    """Node to object 1000; None if the node answers SDO but does not have the object."""
    answers: dict[int, int] = field(default_factory=dict)
    """Nodes that were asked, and how often each answered. Earlier answers to other masters do not count."""

    @property
    def doubled(self) -> set[int]:
        """Nodes that answered one request twice."""
        return {node for node, count in self.answers.items() if count > 1}

    @property
    def silent(self) -> bool:
        return not self.frames and not self.error_frames

    @property
    def nodes(self) -> tuple[int, ...]:
        return tuple(sorted({*self.states, *self.emergencies, *self.device_types}))

    def unexplained(self) -> dict[FrameId, int]:
        """Frames heard that are outside the predefined connection set (CiA 301) of the CANopen nodes, and how often."""
        known = self.nodes

        def explained(identifier: int) -> bool:
            return identifier in (0x000, 0x080, 0x100) or 0x600 < identifier < 0x680 or identifier & 0x7F in known

        return {key: count for key, count in sorted(self.frames.items()) if key[1] or not explained(key[0])}

    def take(self, message: can.Message) -> None:
        """Record one frame."""
        if message.is_error_frame:
            self.error_frames += 1
            return
        identifier, data = message.arbitration_id, bytes(message.data)
        self.frames[identifier, bool(message.is_extended_id)] += 1
        node = identifier & 0x7F
        if message.is_extended_id or message.is_remote_frame or not node or not data:
            return
        match identifier & 0x780:
            case 0x700:
                self.states[node] = _STATES.get(data[0] & 0x7F, f"state 0x{data[0]:02X}")
            case 0x080 if len(data) == 8:
                self.emergencies[node] = int.from_bytes(data[:2], "little")
            case 0x580 if len(data) == 8 and data[1:4] == _UPLOAD_DEVICE_TYPE[1:4]:
                if node in self.answers:
                    self.answers[node] += 1
                self.device_types[node] = int.from_bytes(data[4:], "little") if data[0] == 0x43 else None


class CanSurvey:
    """One open interface, as a context manager. Raises ConnectError when it cannot be opened or fails."""

    def __init__(self, bus: str, settings: CanInterfaceSettings, *, listen_only: bool = False) -> None:
        self._bus, self._settings, self._listen_only = bus, settings, listen_only
        self._interface: can.BusABC | None = None

    def __enter__(self) -> Self:
        self._interface = open_interface(self._bus, self._settings, listen_only=self._listen_only)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        interface, self._interface = self._interface, None
        if interface is not None:
            shut(interface)

    def listen(self, seconds: float, heard: Heard, stopped: Stopped) -> None:
        """Record what arrives within `seconds`, or until stopped."""
        deadline = monotonic() + seconds
        while (left := deadline - monotonic()) > 0 and not stopped():
            self._receive(min(left, _SLICE_S), heard)
        heard.seconds += seconds

    def ask(self, nodes: Sequence[int], wait_s: float, heard: Heard, stopped: Stopped) -> None:
        """Ask each node for its device type, a few at a time to keep the bus from filling; wait for late answers."""
        pace_s = 3 * _FRAME_BITS / self._settings.bitrate
        for number, node in enumerate(nodes, start=1):
            if stopped():
                return
            heard.answers[node] = 0
            self._send(0x600 + node, _UPLOAD_DEVICE_TYPE)
            sleep(pace_s)
            if number % _AT_ONCE == 0:  # python-can's slcan blocks when no byte comes: so not per node
                self.listen(_SLICE_S, heard, stopped)
        self.listen(wait_s, heard, stopped)

    def _receive(self, wait_s: float, heard: Heard) -> None:
        try:
            message = self._open().recv(wait_s)
        except (can.CanError, OSError, ValueError) as error:
            hint = Text("can_is_adapter")
            raise interface_error(self._bus, "", self._settings, error, hint) from error
        if message is not None:
            heard.take(message)

    def _send(self, identifier: int, data: bytes) -> None:
        try:
            self._open().send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            hint = Text("can_no_ack")
            raise interface_error(self._bus, "", self._settings, error, hint) from error

    def _open(self) -> can.BusABC:
        if self._interface is None:
            raise ConnectError(Text("not_open"), bus=self._bus)
        return self._interface
