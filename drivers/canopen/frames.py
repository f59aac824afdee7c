"""Frames on a CANopen bus: the filter for the library, and the latest frames that nodes send without being asked."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from math import inf
from threading import Condition
from time import monotonic
from typing import Any

import can

from drivers.can.bus import KeptFrame
from drivers.canopen.place import CanObject
from drivers.text import Text

_SDO_ANSWERS = range(0x581, 0x600)
_SDO_BYTES = 8
_KIND = 0xE0
"""Bits of the first byte of an SDO answer that say what it is: one of the next three."""
_SEGMENT = 0x00
_BEGINS = 0x40
_ABORT = 0x80
_AT_ONCE = 0x02
"""Bit of the first byte of an SDO answer: all of the number is in this frame."""
_UPLOAD = 0x40
"""First byte of a request to read an object."""
_MOST_DUE = 4
"""How many missing frames of a TPDO are counted: that many may come late."""
_EARLY = 0.7
"""A TPDO that comes after less than this share of its timer is early; of two nodes, each second one is."""
_TOGGLE = 0x10
"""Bit of the first byte of an SDO answer that changes from segment to segment."""
_LAST = 0x01
"""Bit of the first byte of the last segment."""


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
        self._due: dict[int, int] = {}
        """How many frames may come of each TPDO that is sent once after each SYNC."""
        self._doubled_s: dict[int, float] = {}
        """When such a TPDO last came once too often, with other data."""
        self._every_s: dict[int, float] = {}
        """How often each TPDO is sent on its timer."""
        self._early_s: dict[int, float] = {}
        """When such a TPDO last came sooner, with other data."""

    def synchronous(self, identifiers: Iterable[int]) -> None:
        """These are sent once after each SYNC."""
        with self._news:
            for identifier in identifiers:
                self._due.setdefault(identifier, _MOST_DUE)

    def synchronised(self, *_: object) -> None:
        """A SYNC is on the bus."""
        with self._news:
            self._due = {identifier: min(due + 1, _MOST_DUE) for identifier, due in self._due.items()}

    def doubled_s(self, identifiers: Iterable[int]) -> float:
        """When one of these last came once too often, with other data, monotonic; -infinity: never."""
        with self._news:
            return max((self._doubled_s.get(identifier, -inf) for identifier in identifiers), default=-inf)

    def timed(self, every_s: Mapping[int, float]) -> None:
        """These are sent on a timer, this often."""
        with self._news:
            self._every_s |= every_s

    def early_s(self, identifiers: Iterable[int]) -> float:
        """When one of these last came sooner than its timer sends it, with other data, monotonic; -infinity: never."""
        with self._news:
            return max((self._early_s.get(identifier, -inf) for identifier in identifiers), default=-inf)

    def put(self, identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library."""
        with self._news:
            kept = KeptFrame(monotonic(), bytes(data))
            before, every_s = self._came.get(identifier), self._every_s.get(identifier, 0.0)
            if before is not None and kept.came_s - before.came_s < _EARLY * every_s and before.data != kept.data:
                self._early_s[identifier] = kept.came_s
            if (due := self._due.get(identifier)) is not None:
                self._due[identifier] = max(0, due - 1)
                if not due and self._came[identifier].data != kept.data:
                    self._doubled_s[identifier] = kept.came_s
            self._came[identifier] = kept
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
    object's abort. Two different answers to one request come from two nodes with one id. The asking thread calls
    `expect` and `is_in_order`, the receiving one `put` and `other_asked`.
    """

    def __init__(self, take: Callable[[int, bytes, float], object]) -> None:
        self._take = take
        self._address = b""
        self._asked: dict[bytes, float] = {}
        """When each object was last asked for, monotonic."""
        self._toggle: int | None = None
        """Of the next segment; None: none is due."""
        self.other = b""
        """The last answer since the request that did not fit; empty if there was none."""
        self.late_s = 0.0
        """How long the last late answer took."""
        self._due = Counter[bytes]()
        """How many answers may still come, by object."""
        self._latest = b""
        """The latest answer that was due."""
        self.doubled: tuple[float, str] = -inf, ""
        """When one request was last answered twice and differently, monotonic, and how."""

    @property
    def late(self) -> bool:
        """Whether that answer would have fitted an earlier request."""
        return self.other[1:4] in self._asked

    @property
    def in_segments(self) -> bool:
        """Whether more of the number follows when it is asked for."""
        return self._toggle is not None

    def expect(self, wanted: CanObject) -> None:
        """The next request is for this object."""
        self._address = wanted.index.to_bytes(2, "little") + bytes((wanted.subindex,))
        self._asked[self._address] = monotonic()
        self._due[self._address] += 1
        self._toggle, self.other = None, b""

    def is_in_order(self) -> None:
        """Every earlier answer has come, or never will."""
        self._due.clear()

    def other_asked(self, _identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library: another master asks the node."""
        if data[:1] == bytes((_UPLOAD,)):
            self._due[bytes(data[1:4])] += 1

    def put(self, identifier: int, data: bytes | bytearray, timestamp: float) -> None:
        """A callback of the canopen library."""
        answer = bytes(data)
        if answer[0] & _KIND == _BEGINS and self._is_second(answer):
            self.other = answer
        elif self._fits(answer):
            self._take(identifier, answer, timestamp)
        else:
            self.other = answer
            if self.late:
                self.late_s = monotonic() - self._asked[answer[1:4]]

    def _is_second(self, answer: bytes) -> bool:
        """Whether the latest answer comes again where none is due; notes it if it differs."""
        address = answer[1:4]
        if self._due[address]:
            self._due[address] -= 1
            self._latest = answer
            return False
        first = self._latest
        if first[1:4] != address:
            return False
        if first != answer:
            index, sub = int.from_bytes(address[:2], "little"), address[2]
            self.doubled = (
                monotonic(),
                Text(
                    "canopen_answered_twice",
                    place=str(CanObject(index, sub)),
                    one=first.hex(" "),
                    other=answer.hex(" "),
                ),
            )
        return True

    def _fits(self, data: bytes) -> bool:
        kind = data[0] & _KIND
        if kind == _SEGMENT:
            if self._toggle is None or data[0] & _TOGGLE != self._toggle:
                return False
            self._toggle = None if data[0] & _LAST else self._toggle ^ _TOGGLE
            return True
        if kind == _ABORT:  # some nodes state no object
            return data[1:4] in (self._address, bytes(3))
        if data[1:4] != self._address or self._toggle is not None:
            return False
        if kind == _BEGINS and not data[0] & _AT_ONCE:
            self._toggle = 0
        return True
