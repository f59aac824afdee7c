"""A recorded device's answers to each request, and the messages that it sent unasked. No wire, no clock.

A repeated request gets the next of its recorded answers; after the last one the first follows again, and
those that were missing are left out: a silence comes once.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from simulators.devices.covered_reads import TimedBytes, covering, part_of

EXTENDED = 1 << 31
"""Added to an identifier of 29 bits."""
HANG_UP = None
"""Instead of bytes: the device closed the connection."""


@dataclass(frozen=True, slots=True)
class Passed:
    """One recorded event of one wire."""

    at_s: float
    sent: bool
    """By the gateway."""
    data: bytes | None
    """HANG_UP: the device closed the connection."""
    identifier: int | None = None
    """Identifier of a CAN frame; 29 bits have EXTENDED added."""


@dataclass(slots=True)
class Script:
    """What to send. Keys are requests in the form in which `Playback` compares them."""

    answers: Mapping[bytes, Sequence[Sequence[TimedBytes]]]
    unasked: Sequence[TimedBytes] = ()
    """Sent unasked since the start of the connection, in order."""
    lasts_s: float = 0.0
    """Length of the recording, after which the unasked messages are repeated."""
    unknown: int = 0
    """Requests that were not in the recording, nor a part of one that was."""
    is_rtu: bool = False
    """Modbus RTU: a request that reads a part of what was recorded gets that part."""
    _turns: dict[bytes, int] = field(default_factory=dict)

    def answer(self, request: bytes) -> Sequence[TimedBytes]:
        """The next answers to this request; empty if it was never made."""
        said = self.answers.get(request)
        if said is None:
            whole = covering(request, self.answers) if self.is_rtu else None
            if whole is None:
                self.unknown += 1
                return ()
            return part_of(request, whole, self._next(whole))
        answer = self._next(request)
        self._turns[request] = self._turns.get(request, 0) + 1
        return answer

    def _next(self, request: bytes) -> Sequence[TimedBytes]:
        said, turn = self.answers[request], self._turns.get(request, 0)
        if turn < len(said):
            return said[turn]
        again = [each for each in said if each] or said
        return again[(turn - len(said)) % len(again)]


def stream_script(events: Sequence[Passed]) -> Script:
    """The script of a serial line or TCP connection: bytes after a request and before the next one answer it."""
    answers: dict[bytes, list[list[TimedBytes]]] = {}
    unasked: list[TimedBytes] = []
    current: list[TimedBytes] | None = None
    asked_s = began_s = events[0].at_s if events else 0.0
    for event in events:
        if event.sent and event.data:
            current, asked_s = [], event.at_s
            answers.setdefault(event.data, []).append(current)
        elif current is not None:
            current.append((event.at_s - asked_s, event.data))
        elif event.data is not None:
            unasked.append((event.at_s - began_s, event.data))
    return Script(answers, unasked, events[-1].at_s - began_s if events else 0.0)


_SYNC, _EMERGENCY = 0x080, 0x080
_SDO_ANSWER, _SDO_REQUEST = 0x580, 0x600


def can_script(events: Sequence[Passed]) -> Script:
    """The script of a CAN bus. Frames are keyed by `frame_key`; SDO answers belong to their node's request, process
    data to SYNC.

    Everything else, and process data when no SYNC was sent, is unasked: heartbeats, emergencies, plain CAN.
    """
    synchronised = any(event.sent and event.identifier == _SYNC for event in events)
    answers: dict[bytes, list[list[TimedBytes]]] = {}
    unasked: list[TimedBytes] = []
    current: dict[int, tuple[float, list[TimedBytes]]] = {}
    began_s = events[0].at_s if events else 0.0
    for event in events:
        if event.identifier is None or event.data is None:
            continue
        frame = frame_key(event.identifier, event.data)
        if event.sent:
            said: list[TimedBytes] = []
            answers.setdefault(frame, []).append(said)
            current[event.identifier] = event.at_s, said
        elif (asked := current.get(_request_of(event.identifier, synchronised))) is not None:
            asked[1].append((event.at_s - asked[0], frame))
        else:
            unasked.append((event.at_s - began_s, frame))
    return Script(answers, unasked, events[-1].at_s - began_s if events else 0.0)


def _request_of(identifier: int, synchronised: bool) -> int:
    """The frame that this one answers; -1: none."""
    if identifier & EXTENDED:
        return -1
    function, node = identifier & 0x780, identifier & 0x7F
    if function == _SDO_ANSWER:
        return _SDO_REQUEST + node
    if synchronised and node and _EMERGENCY < function < _SDO_ANSWER:
        return _SYNC
    return -1


def frame_key(identifier: int, data: bytes) -> bytes:
    """Identifier and data in one."""
    return identifier.to_bytes(4, "big") + data


def frame_of(key: bytes) -> tuple[int, bytes]:
    """The inverse of `frame_key`."""
    return int.from_bytes(key[:4], "big"), key[4:]


_MBAP = 7


def unnumbered(events: Iterable[Passed]) -> list[Passed]:
    """Modbus TCP: numbers of answers relative to their request's, requests numbered 0.

    The gateway numbers its requests as it likes; a recorded answer that was late remains late by its number.
    """
    number = 0
    rest = 0
    held = b""
    out: list[Passed] = []
    for event in events:
        if event.data is None:
            rest, held = 0, b""
            out.append(event)
        elif event.sent:
            number = int.from_bytes(event.data[:2], "big")
            out.append(Passed(event.at_s, True, bytes(2) + event.data[2:]))
        else:
            data, rest, held = _relative(held + event.data, number, rest)
            if data:
                out.append(Passed(event.at_s, False, data))
    return out


def numbered(data: bytes, number: int, rest: int) -> tuple[bytes, int]:
    """The reverse for one piece of an answer: `rest` bytes of a message that began before come first.

    Returns the piece and how many bytes of its last message are still to come.
    """
    data, rest, held = _relative(data, -number, rest)
    return data + held, rest


def _relative(data: bytes, number: int, rest: int) -> tuple[bytes, int, bytes]:
    """Numbers in `data` less `number`; what is still missing of the last message; the start of a cut header."""
    out = bytearray(data[:rest])
    data, rest = data[rest:], max(0, rest - len(data))
    while len(data) >= _MBAP:
        protocol, length = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:6], "big")
        if protocol or not 2 <= length <= 254:  # a spoilt stream: as it is
            return bytes(out + data), 0, b""
        own = (int.from_bytes(data[:2], "big") - number) & 0xFFFF
        out += own.to_bytes(2, "big") + data[2 : 6 + length]
        rest, data = max(0, 6 + length - len(data)), data[6 + length :]
    return bytes(out), rest, data
