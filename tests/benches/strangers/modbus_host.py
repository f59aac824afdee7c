"""Plays a Modbus device of that nature."""

import random
import struct
from collections.abc import Mapping

from simulators.devices.modbus_servers import crc16
from tests.benches.strangers.driven_loop import DrivenLoop, Line
from tests.benches.strangers.modbus_nature import Memory, Nature

_HEAD = struct.Struct(">HHHB")
_REQUEST_BYTES = 8
_PAUSE_S = 0.02
"""A pause on a serial line, after which a frame begins anew."""
_WIRE_S = 0.001
_APART_S = 1e-6
"""What is sent at one moment may arrive in any order."""


class ForeignModbus:
    """One host or line, with its units."""

    def __init__(self, loop: DrivenLoop, nature: Nature, memories: Mapping[int, Memory], draw: random.Random) -> None:
        self._loop, self._is, self._memories, self._draw = loop, nature, memories, draw
        self._began_s = loop.time()
        self._clients: dict[Line, list[bytes]] = {}
        """Connections that are served, with the last answer on each."""
        self._count: dict[Line, int] = {}
        self._connections = 0
        self._taken_until_s = 0.0
        self._buffer: dict[Line, bytearray] = {}
        self._heard_s = 0.0
        self._free_s: dict[int, float] = {}
        self._answered_s: dict[int, float] = {}
        self.busy_s = 0.0
        self._up = True
        self._sent_s = 0.0
        if nature.restarts:
            loop.call_later(nature.every_s - nature.burst_s, self._restart)

    @property
    def refuses(self) -> bool:
        return not self._up or (self._is.second == "refused" and self._is_taken)

    @property
    def _is_taken(self) -> bool:
        return bool(self._is.lingers_s) and (bool(self._clients) or self._loop.time() < self._taken_until_s)

    def connected(self, line: Line) -> None:
        taken = self._is_taken
        self._connections += 1
        if not taken:
            self._clients[line] = []
            self._count[line], self._buffer[line] = 0, bytearray()
            self._watch(line, self._loop.time())

    def left(self, line: Line) -> None:
        if line in self._clients:
            del self._clients[line]
            self._taken_until_s = self._loop.time() + self._is.lingers_s

    def _restart(self) -> None:
        self._up = False
        for line in list(self._clients):
            line.hang_up()
        self._loop.call_later(self._is.burst_s, self._come_back)
        self._loop.call_later(self._is.every_s, self._restart)

    def _come_back(self) -> None:
        self._up = True

    def _watch(self, line: Line, since_s: float) -> None:
        if self._is.closes_idle_s:
            self._heard_s = since_s
            self._loop.call_later(self._is.closes_idle_s, self._close_idle, line, since_s)

    def _close_idle(self, line: Line, since_s: float) -> None:
        if line.is_open and self._heard_s == since_s:
            line.hang_up()

    def heard(self, line: Line, data: bytes) -> None:
        now_s = self._loop.time()
        if line not in self._clients or not line.is_open or not self._up:
            return
        self._watch(line, now_s)
        if now_s < line.opened_s + self._is.mute_s:
            return
        buffer = self._buffer[line]
        buffer += data
        if self._is.wire == "tcp":
            while len(buffer) > 6 and len(buffer) >= 6 + (length := int.from_bytes(buffer[4:6], "big")):
                number, _, _, unit = _HEAD.unpack_from(buffer)
                self._asked(line, number, unit, bytes(buffer[7 : 6 + length]))
                del buffer[: 6 + length]
            return
        if self._is.echoes:
            line.send(data, now_s)
        while len(buffer) >= _REQUEST_BYTES:
            frame = bytes(buffer[:_REQUEST_BYTES])
            if crc16(frame[:-2]) == frame[-2:]:
                self._asked(line, 0, frame[0], frame[1:-2])
                del buffer[:_REQUEST_BYTES]
            else:
                del buffer[:1]

    def _asked(self, line: Line, number: int, unit: int, pdu: bytes) -> None:
        nature, now_s, draw = self._is, self._loop.time(), self._draw
        if unit not in self._memories:
            return
        odd = not nature.only_last or unit == nature.units
        # The requests of one line, or of one host, are answered one after the other.
        if odd and nature.swallows and draw.random() < nature.swallows:
            return
        took_s, code = 0.002, 0
        begins_s = max(now_s, self._free_s.get(0, 0.0))
        if odd:
            if begins_s < self._answered_s.get(unit, -1e9) + nature.rest_s:
                if not nature.rest_code:
                    return
                code = nature.rest_code
            if nature.burst_code and (now_s - self._began_s) % nature.every_s > nature.every_s - nature.burst_s:
                if nature.burst_code < 0:
                    return
                code = nature.burst_code
            took_s = nature.took_s + draw.random() * nature.jitter_s
            if draw.random() < nature.slower:
                took_s += nature.slower_s
        at_s = (begins_s if nature.in_order or not odd else now_s) + took_s + _WIRE_S
        if nature.in_order or not odd:
            self._free_s[0] = at_s
        self._loop.call_at(at_s, self._answer, line, number, unit, pdu, code, odd)

    def _answer(self, line: Line, number: int, unit: int, pdu: bytes, code: int, odd: bool) -> None:
        if line not in self._clients or not line.is_open or not self._up:
            return
        nature = self._is
        if odd:
            self._answered_s[unit] = self._loop.time()
        frame = self._framed(number, unit, self._right(unit, pdu, code))
        if nature.behind < 0 or self._connections <= nature.behind:
            before = self._clients[line]
            before.append(frame)
            if len(before) < 2:
                return
            frame = before.pop(0)
        if nature.wire == "rtu" and odd:
            frame = self._disturbed(frame)
        self._transmit(line, frame)
        self._count[line] += 1
        if nature.closes_after and self._count[line] >= nature.closes_after:
            self._loop.call_later(nature.pieces_s + 0.001, line.hang_up)

    def _right(self, unit: int, pdu: bytes, code: int) -> bytes:
        """The message that answers this; code: the exception that it is refused with."""
        function, first, count = pdu[0], *struct.unpack(">HH", pdu[1:5])
        words = [self._memories[unit].word(function, first + i, self._loop.time()) for i in range(count)]
        if not code and (None in words or not words):
            code = 2
        if code:
            return bytes((function | 0x80, code))
        data = b"".join(word.to_bytes(2, "big") for word in words if word is not None)
        return bytes((function, len(data))) + data

    def _disturbed(self, frame: bytes) -> bytes:
        nature, draw = self._is, self._draw
        if draw.random() < nature.flips:
            spoilt = bytearray(frame)
            spoilt[draw.randrange(len(frame))] ^= 1 << draw.randrange(8)
            frame = bytes(spoilt)
        return (draw.randbytes(draw.randrange(1, 5)) if draw.random() < nature.noise else b"") + frame

    def _transmit(self, line: Line, frame: bytes) -> None:
        nature, draw, now_s = self._is, self._draw, self._loop.time()
        if nature.pieces_s:
            at = draw.randrange(1, len(frame))
            begins_s = max(now_s, self._sent_s + _APART_S)
            line.send(frame[:at], begins_s)
            self._sent_s = begins_s + nature.pieces_s
            line.send(frame[at:], self._sent_s)
        else:
            line.send(frame, now_s)
        if draw.random() < nature.twice:
            line.send(frame, now_s + nature.pieces_s + draw.uniform(0.001, 0.05))

    def _framed(self, number: int, unit: int, answer: bytes) -> bytes:
        if self._is.wire == "rtu":
            body = bytes((unit,)) + answer
            return body + crc16(body)
        number = {
            "right": number,
            "zero": 0,
            "swapped": (number & 0xFF) << 8 | number >> 8,
            "next": number % 0xFFFF + 1,
        }[self._is.number]
        return _HEAD.pack(number, 0, len(answer) + 1, unit if self._is.answers_as < 0 else self._is.answers_as) + answer
