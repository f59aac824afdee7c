"""Answers Modbus RTU requests that were not recorded from recorded ones that read the same and more.

Whoever reads a played line may ask for less than was recorded: to tell a late answer from the next one, or after a
refusal.
"""

import struct
from collections.abc import Iterable, Sequence

from simulators.devices.modbus_servers import crc16

REQUEST_BYTES = 8
_FIELDS = struct.Struct(">BBHH")
_BITS, _REGISTERS = (1, 2), (3, 4)
_REFUSAL_BYTES = 5
TimedBytes = tuple[float, bytes | None]
"""Seconds after the request (or after the start), and what came."""


def is_read(frame: bytes) -> bool:
    """Whether this is a request to read, with its checksum."""
    if len(frame) != REQUEST_BYTES or crc16(frame[:-2]) != frame[-2:]:
        return False
    return frame[1] in (*_BITS, *_REGISTERS)


def covering(request: bytes, recorded: Iterable[bytes]) -> bytes | None:
    """The recorded request that reads all that this one does; None: there is none."""
    return next((other for other in recorded if is_read(other) and _covers(other, request)), None)


def part_of(request: bytes, recorded: bytes, said: Sequence[TimedBytes]) -> Sequence[TimedBytes]:
    """The part of the answer to a recorded request that answers this one; a refusal as it was.

    Empty if there was no whole answer, as when it was damaged.
    """
    unit, function, first, count = _FIELDS.unpack_from(request)
    _, _, begin, many = _FIELDS.unpack_from(recorded)
    heard = b"".join(data for _, data in said if data is not None)
    refusal, answer = _frame(heard, bytes((unit, function | 0x80)), _REFUSAL_BYTES), b""
    size = 2 * many if function in _REGISTERS else (many + 7) // 8
    if refusal:
        answer = refusal
    elif whole := _frame(heard, bytes((unit, function, size)), size + 5):
        data = whole[3:-2]
        if function in _REGISTERS:
            data = data[2 * (first - begin) : 2 * (first - begin + count)]
        else:
            bits = int.from_bytes(data, "little") >> (first - begin) & ((1 << count) - 1)
            data = bits.to_bytes((count + 7) // 8, "little")
        body = bytes((unit, function, len(data))) + data
        answer = body + crc16(body)
    return [(said[-1][0], answer)] if answer else ()


def _covers(recorded: bytes, request: bytes) -> bool:
    unit, function, first, count = _FIELDS.unpack_from(request)
    other_unit, other_function, begin, many = _FIELDS.unpack_from(recorded)
    return (unit, function) == (other_unit, other_function) and begin <= first and first + count <= begin + many


def _frame(heard: bytes, begin: bytes, length: int) -> bytes:
    """The frame of this length that begins so and has its checksum; empty: there is none."""
    at = heard.find(begin)
    while at >= 0:
        frame = heard[at : at + length]
        if len(frame) == length and crc16(frame[:-2]) == frame[-2:]:
            return frame
        at = heard.find(begin, at + 1)
    return b""
