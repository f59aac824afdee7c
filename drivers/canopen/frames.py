"""Frames on a CANopen bus: the filter for the library, and the latest frames that nodes send without being asked."""

from collections.abc import Callable, Collection
from threading import Condition
from time import monotonic
from typing import Any

import can

from drivers.can.bus import KeptFrame
from drivers.canopen.place import CanObject

_SDO_ANSWERS = range(0x581, 0x600)
_SDO_BYTES = 8
_KIND = 0xE0
"""Bits of the first byte of an SDO answer that say what it is: one of the next three."""
_SEGMENT = 0x00
_BEGINS = 0x40
_ABORT = 0x80
_AT_ONCE = 0x02
"""Bit of the first byte of an SDO answer: all of the number is in this frame."""
_TOGGLE = 0x10
"""Bit of the first byte of an SDO answer that changes from segment to segment."""


def pass_on(network: Any, message: can.Message) -> None:
    """Give the library the frame of a CANopen node. Runs in the receiving thread.

    CiA 301: identifiers have 11 bits, and every SDO frame has eight bytes. Other frames are dropped: the library would
    attribute a frame with a 29-bit identifier to a node, and fail on a short answer.
    """
    identifier, data = message.arbitration_id, message.data
    if message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd:
        return
    if identifier not in _SDO_ANSWERS or len(data) == _SDO_BYTES:
        network.notify(identifier, data, message.timestamp)


class LatestFrames:
    """The newest frame of each subscribed identifier, and when it came. One thread puts, another reads."""

    def __init__(self) -> None:
        self._came: dict[int, KeptFrame] = {}
        self._news = Condition()

    def put(self, identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library."""
        with self._news:
            self._came[identifier] = KeptFrame(monotonic(), bytes(data))
            self._news.notify_all()

    def since(self, oldest_s: float, identifiers: Collection[int], until_s: float) -> dict[int, KeptFrame]:
        """Those that came at monotonic `oldest_s` or later. Waits until `until_s` for missing ones. Blocks."""

        def complete() -> bool:
            return len(self._fresh(oldest_s, identifiers)) == len(set(identifiers))

        with self._news:
            self._news.wait_for(complete, max(0.0, until_s - monotonic()))
            return self._fresh(oldest_s, identifiers)

    def _fresh(self, oldest_s: float, identifiers: Collection[int]) -> dict[int, KeptFrame]:
        came = self._came
        return {i: came[i] for i in identifiers if i in came and came[i].came_s >= oldest_s}


class FittingAnswers:
    """Passes on those SDO answers of one node that fit what is asked, and keeps the last of the others.

    An answer that comes twice, or late, does not fit the next request: the library would give up at it, or take another
    object's abort. The asking thread calls `expect`, the receiving one `put`.
    """

    def __init__(self, take: Callable[[int, bytes, float], object]) -> None:
        self._take = take
        self._address = b""
        self._asked = set[bytes]()
        self._toggle: int | None = None
        self.other = b""
        """The last answer since the request that did not fit; empty if there was none."""

    @property
    def late(self) -> bool:
        """Whether that answer would have fitted an earlier request."""
        return self.other[1:4] in self._asked

    def expect(self, wanted: CanObject) -> None:
        """The next request is for this object."""
        self._address = wanted.index.to_bytes(2, "little") + bytes((wanted.subindex,))
        self._asked.add(self._address)
        self._toggle, self.other = None, b""

    def put(self, identifier: int, data: bytes | bytearray, timestamp: float) -> None:
        """A callback of the canopen library."""
        answer = bytes(data)
        if self._fits(answer):
            self._take(identifier, answer, timestamp)
        else:
            self.other = answer

    def _fits(self, data: bytes) -> bool:
        kind = data[0] & _KIND
        if kind == _SEGMENT:
            if self._toggle is None or data[0] & _TOGGLE != self._toggle:
                return False
            self._toggle ^= _TOGGLE
            return True
        if kind == _ABORT:  # some nodes state no object
            return data[1:4] in (self._address, bytes(3))
        if data[1:4] != self._address or self._toggle is not None:
            return False
        if kind == _BEGINS and not data[0] & _AT_ONCE:
            self._toggle = 0
        return True
