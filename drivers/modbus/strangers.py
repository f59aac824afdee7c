"""Detects another master on the line by frames that are neither ours nor an answer to one of our requests.

Disturbed bytes do not count: only whole frames with their checksum, three of them within a minute.
"""

from collections import deque
from collections.abc import Iterator

from drivers.modbus.frames import find_rtu_answer, is_rtu_frame, rtu_request
from drivers.modbus.numbers import BIT_FUNCTIONS, REGISTER_FUNCTIONS, Block
from drivers.text import Text

_READS = (*BIT_FUNCTIONS, *REGISTER_FUNCTIONS)
_FIXED = (*_READS, 5, 6, 15, 16)
"""Functions whose request, or the answer to it, has eight bytes."""
_LAST_UNIT = 247
_ENOUGH = 3
_WITHIN_S = 60.0
_REQUEST_BYTES = 8
_SEARCHED = 512
"""How many of the bytes heard are searched: a line that babbles must not cost more."""


class Strangers:
    """Frames that only another master explains."""

    def __init__(self) -> None:
        self._requests: set[bytes] = set()
        self._answers: set[tuple[int, ...]] = set()
        self._known: set[tuple[int, Block]] = set()
        self._heard: deque[tuple[float, str]] = deque(maxlen=100)
        self._latest = bytearray()
        self._latest_s = 0.0

    def asked(self, unit: int, block: Block) -> None:
        """This was sent: neither it nor its answers are another's, however often and late they come."""
        if (unit, block) not in self._known:
            self._known.add((unit, block))
            self._requests.add(rtu_request(unit, block))
            self._answers |= {(unit, block.function, block.data_bytes), (unit, block.function | 0x80)}

    def note(self, heard: bytes | bytearray, now_s: float) -> None:
        """Look for them in what was heard. now_s: monotonic"""
        for frame in _frames(bytes(heard[-_SEARCHED:])):
            if frame not in self._requests and self._form(frame) not in self._answers:
                self._heard.append((now_s, _told(frame)))

    def hear(self, heard: bytes | bytearray, now_s: float) -> None:
        """All that is heard on the line, in order. now_s: monotonic"""
        self._latest += heard
        del self._latest[:-_SEARCHED]
        self._latest_s = now_s

    def forget(self) -> None:
        """A request of ours is answered, so that all before it is, too."""
        self._latest.clear()

    @property
    def tail(self) -> bytes:
        """What may be the beginning of a request."""
        return bytes(self._latest[1 - _REQUEST_BYTES :])

    def waits(self, unit: int, block: Block, since_s: float) -> bool:
        """Whether another's request to this unit, heard since then, has no answer yet and looks like the block's."""
        if self._latest_s < since_s:
            self._latest.clear()
        at = _last_request(self._latest, unit, block)
        return at >= 0 and find_rtu_answer(self._latest[at:], unit, block) is None

    @staticmethod
    def asks(heard: bytes | bytearray, unit: int, block: Block) -> bool:
        """Whether these bytes hold another's request to this unit whose answer looks like the block's."""
        return _last_request(heard, unit, block) >= 0

    def evidence(self, now_s: float) -> str:
        """What shows that there is another master, in words; empty if nothing does."""
        recent = [text for at_s, text in self._heard if now_s - at_s < _WITHIN_S]
        if len(recent) < _ENOUGH:
            return ""
        return Text("frames_not_ours", count=len(recent), such=recent[-1])

    def _form(self, frame: bytes) -> tuple[int, ...]:
        unit, function = frame[0], frame[1]
        return (unit, function) if function & 0x80 else (unit, function, frame[2])


def _frames(heard: bytes) -> Iterator[bytes]:
    """Every whole frame."""
    start = 0
    while start <= len(heard) - 5:
        length = next((n for n in _lengths(heard, start) if is_rtu_frame(heard[start : start + n])), 0)
        if length:
            yield heard[start : start + length]
        start += length or 1


def _lengths(heard: bytes, start: int) -> Iterator[int]:
    """How long a frame that begins here may be, as far as it is whole."""
    unit, function, third = heard[start : start + 3]
    if not 1 <= unit <= _LAST_UNIT:
        return
    possible = []
    if function & 0x7F in _FIXED and function & 0x80:
        possible.append(5)
    if function in _READS and third:
        possible.append(5 + third)
    if function in _FIXED:
        possible.append(8)
    yield from (length for length in possible if start + length <= len(heard))


def _last_request(heard: bytes | bytearray, unit: int, block: Block) -> int:
    """Where another's last request to the unit begins whose answer looks like the block's; -1: there is none."""
    own, begin, at = rtu_request(unit, block), bytes((unit, block.function)), len(heard)
    while (at := heard.rfind(begin, 0, at + 1)) >= 0:
        frame = bytes(heard[at : at + _REQUEST_BYTES])
        if len(frame) == _REQUEST_BYTES and frame != own and is_rtu_frame(frame):
            address, count = (int.from_bytes(frame[k : k + 2], "big") for k in (2, 4))
            if block.is_like(Block(block.function, address, count)):
                return at
    return -1


def _told(frame: bytes) -> str:
    """The frame in words. One of eight bytes may be a request or an answer."""
    unit, function = frame[0], frame[1] & 0x7F
    return Text("modbus_frame", unit=unit, function=function, bytes=frame[:12].hex(" "))
