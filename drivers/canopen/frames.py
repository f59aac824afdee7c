"""Frames on a CANopen bus: the filter for the library, and the latest frames that nodes send without being asked."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from math import inf
from queue import SimpleQueue
from threading import Condition
from time import monotonic
from typing import Any

import can

from drivers.can.bus import KeptFrame
from drivers.canopen.place import BEGINS, KIND, CanObject
from drivers.text import Text

_SDO_ANSWERS = range(0x581, 0x600)
_SDO_BYTES = 8
_MOST_DUE = 4
"""How many missing frames of a TPDO are counted: that many may come late."""
_EARLY = 0.7
"""A TPDO that comes after less than this share of its timer is early; of two nodes, each second one is."""


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


class SdoAnswers:
    """The SDO answers of one node as they come. Two different ones to one request come from two nodes with one id; an
    equal one is a copy and is dropped. The asking thread calls `expect`, `settled` and `get`, the receiving one `put`
    and `other_asked`.
    """

    def __init__(self) -> None:
        self._came = SimpleQueue[tuple[float, bytes]]()
        self._due = Counter[bytes]()
        """How many answers may still come, by object."""
        self._latest = b""
        """The latest answer that was due."""
        self.doubled: tuple[float, str] = -inf, ""
        """When one request was last answered twice and differently, monotonic, and how."""

    def expect(self, wanted: CanObject) -> None:
        """This object is asked for."""
        self._due[wanted.address] += 1

    def settled(self) -> None:
        """Every earlier answer has come, or never will."""
        self._due.clear()

    def get(self, until_s: float) -> tuple[float, bytes]:
        """The next one, and when it came. Waits until monotonic `until_s`; raises queue.Empty. Blocks."""
        return self._came.get(timeout=max(0.0, until_s - monotonic()))

    def other_asked(self, _identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library: another master asks the node."""
        if data[:1] == bytes((BEGINS,)):
            self._due[bytes(data[1:4])] += 1

    def put(self, _identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library."""
        answer = bytes(data)
        if not (answer[0] & KIND == BEGINS and self._is_second(answer)):
            self._came.put((monotonic(), answer))

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
            place = str(CanObject(int.from_bytes(address[:2], "little"), address[2]))
            how = Text("canopen_answered_twice", place=place, one=first.hex(" "), other=answer.hex(" "))
            self.doubled = monotonic(), how
        return True
