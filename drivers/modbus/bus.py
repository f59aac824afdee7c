"""Modbus RTU and TCP: one request, one answer. A late answer, or one of another device, is never accepted.

pymodbus encodes and decodes the messages and checksums. Its client is not used: after a timeout or a cancelled await it
hands the late answer to the next RTU request, and one dead unit behind a gateway makes it close the connection that
other units share. Sources: MODBUS Application Protocol V1.1b3; MODBUS over serial line V1.02.
"""

import asyncio
import struct
from abc import ABC, abstractmethod

from pymodbus.exceptions import ModbusException
from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadDiscreteInputsRequest
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

from drivers.base import BadAnswer, NoAnswer, Refused
from drivers.byte_stream import ByteStream, SerialStream, TcpStream
from drivers.modbus.numbers import BIT_FUNCTIONS, Block
from drivers.modbus.settings import ModbusRtuSettings, ModbusTcpSettings
from drivers.patience import Patience
from drivers.tap import Tap

_REQUESTS: dict[int, type[ModbusPDU]] = {
    1: ReadCoilsRequest,
    2: ReadDiscreteInputsRequest,
    3: ReadHoldingRegistersRequest,
    4: ReadInputRegistersRequest,
}
_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge, not ready yet",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target did not respond",
}
_TARGET_SILENT = (10, 11)
_DECODER = DecodePDU(False)
_HEADER = struct.Struct(">HHHB")  # transaction, protocol 0, length, unit
_LONGEST_TCP_LENGTH = 254
_MOST_HEARD = 4096
"""How many bytes are searched for the answer to one request."""


class ModbusBus(ABC):
    """A connection that several units share; requests queue in order of arrival."""

    kind: str
    units: tuple[int, int]

    def __init__(self, name: str, stream: ByteStream, timeout_s: float) -> None:
        self._name, self._stream, self._timeout_s = name, stream, timeout_s
        self._patience = Patience(timeout_s)
        self._lock = asyncio.Lock()

    @property
    def name(self) -> str:
        return self._name

    @property
    def timeout_s(self) -> float:
        return self._timeout_s

    async def connect(self) -> None:
        """Open the wire, unless it is already open. Raises ConnectError."""
        async with self._lock:
            if not self._stream.is_open:
                await self._stream.open(self._timeout_s)
                self._opened()

    async def close(self) -> None:
        async with self._lock:
            await self._stream.close()

    async def read(self, device: str, unit: int, block: Block) -> tuple[int, ...]:
        """Registers (0..65535) or bits (0, 1) of one block.

        Raises NoAnswer, BadAnswer, Refused (exception code) or ConnectError (wire lost).
        """
        async with self._lock:
            pdu = await self._exchange(device, unit, block)
        if isinstance(pdu, ExceptionResponse):
            raise self._exception(device, unit, block, pdu.exception_code)
        if block.function in BIT_FUNCTIONS:
            return tuple(int(bit) for bit in pdu.bits[: block.count])
        return tuple(pdu.registers)

    def _opened(self) -> None:  # noqa: B027 - not every bus has something to reset
        """Reset what belonged to the last connection."""

    @abstractmethod
    async def _exchange(self, device: str, unit: int, block: Block) -> ModbusPDU:
        """Send the request and wait for its answer, which may be an ExceptionResponse."""

    def _silence(self, device: str, unit: int, waited_s: float) -> NoAnswer:
        return NoAnswer(
            f"unit {unit} did not answer within {waited_s:.3g} s",
            hurried=waited_s < self._timeout_s,
            bus=self._name,
            device=device,
            hint="check power, wiring, unit id and baud",
        )

    def _exception(self, device: str, unit: int, block: Block, code: int) -> NoAnswer | Refused:
        meaning = _EXCEPTIONS.get(code, "unknown exception")
        what = f"unit {unit} answered function {block.function}, address {block.address}, count {block.count} with "
        if code in _TARGET_SILENT:
            return NoAnswer(f"{what}exception {code}: {meaning}", bus=self._name, device=device)
        return Refused(
            f"{what}exception {code}: {meaning}", bus=self._name, device=device, hint="does the profile fit the device?"
        )


class ModbusRtuBus(ModbusBus):
    """Units on one serial line.

    RTU answers are not numbered, so a late answer looks like the next one. After a timeout or a cancelled wait, the
    unit's next request is therefore preceded by one with an answer of another length: a serial unit answers in order,
    so once that request is answered nothing older can follow.
    """

    kind = "modbus_rtu"
    units = (1, 247)

    def __init__(self, name: str, settings: ModbusRtuSettings, tap: Tap | None = None) -> None:
        super().__init__(name, SerialStream(name, settings, tap), settings.timeout_s)
        self._gap_s = 3.5 * 11 / settings.baud
        self._quiet_since = 0.0
        self._owing: tuple[int, float] | None = None
        self._doubtful: set[int] = set()

    def _opened(self) -> None:
        self._owing = None

    async def _exchange(self, device: str, unit: int, block: Block) -> ModbusPDU:
        await self._wait_for_owed_answer()
        if unit in self._doubtful:
            await self._request(device, unit, _separator(block))
            self._doubtful.discard(unit)
        return await self._request(device, unit, block)

    async def _request(self, device: str, unit: int, block: Block) -> ModbusPDU:
        loop = asyncio.get_running_loop()
        await asyncio.sleep(self._quiet_since + self._gap_s - loop.time())
        self._stream.discard()
        frame = bytes([unit]) + _request_pdu(block)
        self._stream.write(frame + FramerRTU.compute_CRC(frame).to_bytes(2, "big"))
        sent = loop.time()
        wait_s = self._patience.wait_s(unit, block)
        self._owing = unit, sent + self._timeout_s
        self._doubtful.add(unit)
        heard = bytearray()
        until = sent + wait_s
        try:
            while (pdu := find_rtu_answer(heard, unit, block)) is None:
                heard += await self._stream.read(until - loop.time())
                until = min(sent + self._timeout_s, loop.time() + wait_s)  # lets an answer that has begun finish
        except TimeoutError:
            self._owing = None
            self._patience.missed(unit)
            raise self._nothing_valid(device, unit, heard, wait_s) from None
        finally:
            self._quiet_since = loop.time()
        self._owing = None
        self._doubtful.discard(unit)
        self._patience.answered(unit, block, loop.time() - sent)
        return _decode(pdu, self._name, device)

    async def _wait_for_owed_answer(self) -> None:
        """Let the unit finish answering a cancelled request; otherwise two would talk at once."""
        if self._owing is None:
            return
        unit, deadline = self._owing
        loop = asyncio.get_running_loop()
        try:
            while True:
                await self._stream.read(deadline - loop.time())
                deadline = min(deadline, loop.time() + max(0.02, 4 * self._gap_s))
        except TimeoutError:
            self._doubtful.add(unit)
            self._owing = None

    def _nothing_valid(self, device: str, unit: int, heard: bytes | bytearray, waited_s: float) -> NoAnswer | BadAnswer:
        if not heard:
            return self._silence(device, unit, waited_s)
        return BadAnswer(
            f"{len(heard)} bytes received, but no valid answer of unit {unit}: {heard[:16].hex(' ')}",
            bus=self._name,
            device=device,
            hint="two units with one id, wrong baud or parity, missing termination, or noise",
        )


class ModbusTcpBus(ModbusBus):
    """Units behind one host. Answers carry the request's number, which identifies late and foreign ones."""

    kind = "modbus_tcp"
    units = (0, 255)

    def __init__(self, name: str, settings: ModbusTcpSettings, tap: Tap | None = None) -> None:
        super().__init__(name, TcpStream(name, settings.host, settings.port, tap), settings.timeout_s)
        self._number = 0
        self._perhaps_busy_until, self._mute = 0.0, False

    def _opened(self) -> None:
        self._perhaps_busy_until, self._mute = 0.0, False

    async def _exchange(self, device: str, unit: int, block: Block) -> ModbusPDU:
        self._number = self._number % 0xFFFF + 1
        pdu = _request_pdu(block)
        self._stream.discard()
        self._stream.write(_HEADER.pack(self._number, 0, len(pdu) + 1, unit) + pdu)
        loop = asyncio.get_running_loop()
        sent = loop.time()
        wait_s = self._patience.wait_s(unit, block)
        if (
            sent < self._perhaps_busy_until
        ):  # a gateway asks its units one after the other, and may be waiting for a silent one
            wait_s = self._timeout_s
        heard = bytearray()
        until = sent + wait_s
        try:
            while (found := find_tcp_answer(heard, self._number)) is None:
                del heard[:-_MOST_HEARD]
                heard += await self._stream.read(until - loop.time())
                until = min(sent + self._timeout_s, loop.time() + wait_s)  # lets an answer that has begun finish
        except TimeoutError:
            self._patience.missed(unit)
            # Not a byte within the full timeout, not even of a late answer: this is not a busy gateway.
            self._mute = not heard and (self._mute or wait_s >= self._timeout_s)
            self._perhaps_busy_until = 0.0 if self._mute else loop.time() + self._timeout_s
            raise self._nothing_valid(device, unit, heard, wait_s) from None
        self._perhaps_busy_until, self._mute = 0.0, False
        answering, answer = found
        if answering == unit and answer[0] == block.function:
            self._patience.answered(unit, block, loop.time() - sent)
        if answering != unit:
            raise BadAnswer(f"unit {answering} answered instead of unit {unit}", bus=self._name, device=device)
        if not _fits(answer, block):
            raise BadAnswer(
                f"the answer does not fit function {block.function}, count {block.count}: {answer[:16].hex(' ')}",
                bus=self._name,
                device=device,
            )
        return _decode(answer, self._name, device)

    def _nothing_valid(self, device: str, unit: int, heard: bytes | bytearray, waited_s: float) -> NoAnswer | BadAnswer:
        if _messages(heard)[1] == len(heard):  # nothing, or late answers only
            return self._silence(device, unit, waited_s)
        return BadAnswer(
            f"the bytes received are not a complete Modbus TCP answer: {heard[:16].hex(' ')}",
            bus=self._name,
            device=device,
            hint="check host and port; is the device's serial side disturbed?",
        )


def find_tcp_answer(heard: bytes | bytearray, number: int) -> tuple[int, bytes] | None:
    """Unit and message (function code and data) of the answer with this number, or None if it has not arrived yet.

    Late answers, which have other numbers, are skipped. Where the bytes are invalid, or begin a message that has not
    ended, the answer is searched for at every later position, because noise may look like a header.
    """
    messages, end = _messages(heard)
    if number in messages:
        return messages[number]
    if end == len(heard):
        return None
    start = -1
    header = struct.pack(">HH", number, 0)
    while (start := heard.find(header, start + 1)) >= 0:
        if (found := _message_at(heard, start)) is not None:
            return found[1:]
    return None


def _messages(heard: bytes | bytearray) -> tuple[dict[int, tuple[int, bytes]], int]:
    """The complete messages that follow one another from the first byte on, by number, and the position after them."""
    messages, end = {}, 0
    while (found := _message_at(heard, end)) is not None:
        number, unit, message = found
        messages[number] = unit, message
        end += _HEADER.size + len(message)
    return messages, end


def _message_at(heard: bytes | bytearray, start: int) -> tuple[int, int, bytes] | None:
    """Number, unit and message; None if no complete message is at this position."""
    if len(heard) - start <= _HEADER.size:
        return None
    number, protocol, length, unit = _HEADER.unpack_from(heard, start)
    message = bytes(heard[start + _HEADER.size : start + 6 + length])
    if protocol != 0 or not 2 <= length <= _LONGEST_TCP_LENGTH or len(message) != length - 1:
        return None
    return number, unit, message


def find_rtu_answer(heard: bytes | bytearray, unit: int, block: Block) -> bytes | None:
    """The message (function code and data) of the first frame in `heard` that answers this request, or None.

    Frames of other units, functions or lengths, broken frames and noise are skipped.
    """
    normal = bytes((unit, block.function, _data_bytes(block)))
    refused = bytes((unit, block.function | 0x80))
    for start in range(len(heard) - 4):
        if heard.startswith(normal, start):
            end = start + 3 + _data_bytes(block) + 2
        elif heard.startswith(refused, start):
            end = start + 5
        else:
            continue
        frame = bytes(heard[start:end])
        if start + len(frame) == end and FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big")):
            return frame[1:-2]
    return None


def _fits(answer: bytes, block: Block) -> bool:
    if answer[0] == block.function | 0x80:
        return len(answer) == 2
    return answer[:2] == bytes((block.function, _data_bytes(block))) and len(answer) == 2 + answer[1]


def _data_bytes(block: Block) -> int:
    return (block.count + 7) // 8 if block.function in BIT_FUNCTIONS else 2 * block.count


def _separator(block: Block) -> Block:
    """A request that is answered with another length than this block's, so that the two cannot be confused. The unit
    may refuse it."""
    count = (1 if block.count > 8 else 9) if block.function in BIT_FUNCTIONS else (1 if block.count > 1 else 2)
    return Block(block.function, block.address, count)


def _request_pdu(block: Block) -> bytes:
    request = _REQUESTS[block.function](address=block.address, count=block.count)
    return bytes([block.function]) + request.encode()


def _decode(message: bytes, bus: str, device: str) -> ModbusPDU:
    try:
        pdu = _DECODER.decode(message)
    except (ModbusException, ValueError, struct.error, IndexError) as error:
        raise BadAnswer(f"cannot be decoded: {error}: {message.hex(' ')}", bus=bus, device=device) from error
    if pdu is None:
        raise BadAnswer(f"cannot be decoded: {message.hex(' ')}", bus=bus, device=device)
    return pdu
