"""Finds the answer to a request in the received bytes: RTU frames and TCP messages."""

import struct
from collections.abc import Iterable, Iterator
from functools import lru_cache

from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.bit_message import (
    ReadCoilsRequest,
    ReadCoilsResponse,
    ReadDiscreteInputsRequest,
    ReadDiscreteInputsResponse,
)
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
)

from drivers.modbus.numbers import Block
from drivers.requests import REFUSED

_REQUESTS: dict[int, type[ModbusPDU]] = {
    1: ReadCoilsRequest,
    2: ReadDiscreteInputsRequest,
    3: ReadHoldingRegistersRequest,
    4: ReadInputRegistersRequest,
}
RESPONSES: dict[int, type[ModbusPDU]] = {
    1: ReadCoilsResponse,
    2: ReadDiscreteInputsResponse,
    3: ReadHoldingRegistersResponse,
    4: ReadInputRegistersResponse,
}
"""What each function is answered with, unless it is refused."""
TCP_HEADER = struct.Struct(">HHHB")
"""Number of the transaction, protocol 0, length, unit."""
_LONGEST_TCP_LENGTH = 254
_REFUSAL_LENGTH = 5
"""How many bytes a refusal has on a serial line."""
_REMEMBERED = 4096
"""Requests kept: the same ones are sent in every period."""


def rtu_length(block: Block) -> int:
    """How many bytes the answer to this request has on a serial line."""
    return 3 + block.data_bytes + 2


def rtu_frame(body: bytes) -> bytes:
    """Unit and message with their checksum."""
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


@lru_cache(maxsize=_REMEMBERED)
def request_pdu(block: Block) -> bytes:
    """Function code and data of the request."""
    request = _REQUESTS[block.function](address=block.address, count=block.count)
    return bytes([block.function]) + request.encode()


@lru_cache(maxsize=_REMEMBERED)
def rtu_request(unit: int, block: Block) -> bytes:
    """The request on a serial line."""
    return rtu_frame(bytes([unit]) + request_pdu(block))


def is_rtu_frame(frame: bytes | bytearray) -> bool:
    """Whether these bytes end with the checksum of the others."""
    return len(frame) >= 4 and FramerRTU.check_CRC(bytes(frame[:-2]), int.from_bytes(frame[-2:], "big"))


def rtu_answers(heard: bytes | bytearray, unit: int, block: Block) -> Iterator[bytes]:
    """The message (function code and data) of every frame in `heard` that answers this request.

    Frames of other units, functions or lengths, broken frames and noise are skipped.
    """
    normal = bytes((unit, block.function, block.data_bytes))
    refused = bytes((unit, block.function | 0x80))
    start = 0
    while start < len(heard) - 4:
        length = (
            rtu_length(block)
            if heard.startswith(normal, start)
            else _REFUSAL_LENGTH
            if heard.startswith(refused, start)
            else 0
        )
        frame = bytes(heard[start : start + length])
        if length and len(frame) == length and is_rtu_frame(frame):
            yield frame[1:-2]
            start += length
        else:
            start += 1


def find_rtu_answer(heard: bytes | bytearray, unit: int, block: Block) -> bytes | None:
    """The first of `rtu_answers`, or None."""
    return next(rtu_answers(heard, unit, block), None)


def rtu_messages(
    heard: bytes | bytearray, start: int, due: Iterable[tuple[int, Block]]
) -> Iterator[tuple[int, int, bytes]]:
    """End, unit and message (function code and data) of every valid frame from `start` on that has the form of the
    answer of a unit to what is due of it, or of its refusal. What is between them is skipped.
    """
    forms = {(unit, block.function, block.data_bytes) for unit, block in due}
    refused = {(unit, function | REFUSED) for unit, function, _ in forms}
    while start < len(heard) - 4:
        unit, function, size = heard[start : start + 3]
        length = 5 + size if (unit, function, size) in forms else _REFUSAL_LENGTH if (unit, function) in refused else 0
        frame = bytes(heard[start : start + length])
        if length and len(frame) == length and is_rtu_frame(frame):
            start += length
            yield start, unit, frame[1:-2]
        else:
            start += 1


def is_damaged(heard: bytes | bytearray, block: Block) -> bool:
    """Whether this is as long as an answer to the request and nobody's valid answer."""
    return len(heard) == rtu_length(block) and not is_rtu_frame(heard)


def is_damaged_of(heard: bytes | bytearray, unit: int, block: Block) -> bool:
    """Whether it also begins as that unit's answer does: a late one of another unit may be damaged, too."""
    return is_damaged(heard, block) and heard[:3] == bytes((unit, block.function, block.data_bytes))


def foreign_refusal(heard: bytes | bytearray, unit: int) -> bytes | None:
    """The message of a refusal by this unit at the end of these bytes, whatever function it names; None: there is none.

    Some devices refuse with one function code, whatever they are asked.
    """
    frame = bytes(heard[-_REFUSAL_LENGTH:])
    if len(frame) < _REFUSAL_LENGTH or frame[0] != unit or not frame[1] & 0x80 or not is_rtu_frame(frame):
        return None
    return frame[1:-2]


def plausibly_of(heard: bytes | bytearray, unit: int, block: Block) -> bool:
    """Whether these bytes, none of them a valid answer to the request, may come from that unit, disturbed.

    So may an answer of the right length, and whatever begins with the unit's id or holds it before the function code;
    not so a valid frame of another unit.
    """
    if is_rtu_frame(heard):
        return heard[0] == unit
    return (
        len(heard) == rtu_length(block)
        or heard[:1] == bytes((unit,))
        or any(bytes((unit, code)) in heard for code in (block.function, block.function | 0x80))
    )


def fits(answer: bytes, block: Block) -> bool:
    """Whether a message (function code and data) answers this request."""
    if answer[0] == block.function | 0x80:
        return len(answer) == 2
    return answer[:2] == bytes((block.function, block.data_bytes)) and len(answer) == 2 + answer[1]


def is_refusal(answer: bytes) -> bool:
    """Whether a message (function code and data) has the form of a refusal, of whatever function."""
    return len(answer) == 2 and bool(answer[0] & 0x80)


def find_tcp_answer(heard: bytes | bytearray, number: int) -> tuple[int, bytes] | None:
    """Unit and message (function code and data) of the answer with this number, or None if it has not arrived yet.

    Late answers, which have other numbers, are skipped. Where the bytes are invalid, or begin a message that has not
    ended, the answer is searched for at every later position, because noise may look like a header.
    """
    messages, end = tcp_messages(heard)
    numbered = {found: (unit, message) for found, unit, message in messages}
    if number in numbered:
        return numbered[number]
    if end == len(heard):
        return None
    start = -1
    header = struct.pack(">HH", number, 0)
    while (start := heard.find(header, start + 1)) >= 0:
        if (found := _message_at(heard, start)) is not None:
            return found[1:]
    return None


def tcp_messages(heard: bytes | bytearray) -> tuple[list[tuple[int, int, bytes]], int]:
    """Number, unit and message of the complete messages that follow one another from the first byte on, and the
    position after them."""
    messages, end = [], 0
    while (found := _message_at(heard, end)) is not None:
        messages.append(found)
        end += TCP_HEADER.size + len(found[2])
    return messages, end


def begins_message(heard: bytes | bytearray) -> bool:
    """Whether a message may begin so that has not ended yet."""
    if len(heard) < TCP_HEADER.size:
        return True
    length: int
    _, protocol, length, _ = TCP_HEADER.unpack_from(heard)
    return not protocol and 2 <= length <= _LONGEST_TCP_LENGTH


def _message_at(heard: bytes | bytearray, start: int) -> tuple[int, int, bytes] | None:
    """Number, unit and message; None if no complete message is at this position."""
    if len(heard) - start <= TCP_HEADER.size:
        return None
    number, protocol, length, unit = TCP_HEADER.unpack_from(heard, start)
    message = bytes(heard[start + TCP_HEADER.size : start + 6 + length])
    if protocol != 0 or not 2 <= length <= _LONGEST_TCP_LENGTH or len(message) != length - 1:
        return None
    return number, unit, message
