"""Modbus RTU and TCP: one request, one answer. A late answer, or one of another device, is never accepted.

pymodbus encodes and decodes the messages and checksums. Its client is not used: after a timeout or a cancelled await it
hands the late answer to the next RTU request, and one dead unit behind a gateway makes it close the connection that
other units share. Sources: MODBUS Application Protocol V1.1b3; MODBUS over serial line V1.02.
"""

import asyncio
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import suppress

from pymodbus.exceptions import ModbusException
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.byte_stream import ByteStream, SerialStream, TcpStream
from drivers.modbus.frames import (
    TCP_HEADER,
    find_rtu_answer,
    find_tcp_answer,
    fits,
    is_damaged,
    plausibly_of,
    request_pdu,
    rtu_answers,
    rtu_request,
    tcp_messages,
)
from drivers.modbus.numbers import BIT_FUNCTIONS, Block
from drivers.modbus.refusals import refusal
from drivers.modbus.settings import ModbusRtuSettings, ModbusTcpSettings
from drivers.modbus.unanswered import Unanswered
from drivers.patience import Patience
from drivers.tap import Tap

_DECODER = DecodePDU(False)
_MOST_HEARD = 4096
"""How many bytes are searched for the answer to one request."""
_MOST_SENT = 2
"""How often a silent unit is sent one question before its late answer is waited for: more would slow it down."""
_FOLLOWS_S = 0.05
"""How soon the answer to a repeated request follows the answer to the first one."""


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
                await self._open()

    async def close(self) -> None:
        async with self._lock:
            await self._stream.close()

    async def read(self, device: str, unit: int, block: Block, *, again: bool = False) -> tuple[int, ...]:
        """Registers (0..65535) or bits (0, 1) of one block.

        again: this repeats a question to the unit, so that an answer to what was sent before is as good

        Raises NoAnswer, BadAnswer, Refused (exception code) or ConnectError (wire lost).
        """
        async with self._lock:
            pdu = await self._answer(device, unit, block, again)
        if isinstance(pdu, ExceptionResponse):
            raise refusal(self._name, device, unit, block, pdu.exception_code)
        if block.function in BIT_FUNCTIONS:
            return tuple(int(bit) for bit in pdu.bits[: block.count])
        return tuple(pdu.registers)

    async def _open(self) -> None:
        await self._stream.open(self._timeout_s)
        self._opened()

    def _opened(self) -> None:  # noqa: B027 - not every bus has something to reset
        """Reset what belonged to the last connection."""

    async def _answer(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        """As `_exchange`; a bus that may open its wire anew does so here."""
        return await self._exchange(device, unit, block, again)

    @abstractmethod
    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        """Send the request and wait for its answer, which may be an ExceptionResponse.

        again: see `read`
        """

    def _silence(self, device: str, unit: int, waited_s: float, *, heard: bool = False) -> NoAnswer:
        return NoAnswer(
            f"unit {unit} did not answer within {waited_s:.3g} s",
            hurried=waited_s < self._timeout_s,
            heard=heard,
            bus=self._name,
            device=device,
            hint="check power, wiring, unit id and baud",
        )


class ModbusRtuBus(ModbusBus):
    """Units on one serial line. `Unanswered` says how late answers are told from the next ones."""

    kind = "modbus_rtu"
    units = (1, 247)

    def __init__(self, name: str, settings: ModbusRtuSettings, tap: Tap | None = None) -> None:
        super().__init__(name, SerialStream(name, settings, tap), settings.timeout_s)
        self._gap_s = 3.5 * 11 / settings.baud
        self._pause_s = max(0.02, 4 * self._gap_s)
        """After a pause of this length, what was being sent has ended."""
        self._quiet_since = 0.0
        self._owing_until: float | None = None
        """Until when the answer to a cancelled request may come."""
        self._unanswered = Unanswered()
        self._echo = settings.local_echo
        """Whether each request is received before its answer; None: not known yet."""

    def _opened(self) -> None:
        self._owing_until = None

    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        await self._wait_for_owed_answer()
        self._unanswered.note(self._stream.discard())
        if not again:
            self._unanswered.begin(unit)
        separator = self._unanswered.separator(unit, block)
        if separator is None and self._echo is None and find_rtu_answer(rtu_request(unit, block), unit, block):
            # The request would be its own answer: learn from another one whether requests come back.
            separator = self._unanswered.another(unit, block)
        if separator is not None:
            await self._request(device, unit, separator)
            self._unanswered.separated(unit)
        return await self._request(device, unit, block)

    async def _request(self, device: str, unit: int, block: Block) -> ModbusPDU:
        loop = asyncio.get_running_loop()
        await asyncio.sleep(self._quiet_since + self._gap_s - loop.time())
        self._unanswered.note(self._stream.discard())
        asked = self._unanswered.asked(unit, block)
        began = loop.time()
        self._owing_until = began + self._timeout_s
        heard = bytearray()
        message: bytes | None = None
        wait_s = self._timeout_s
        try:
            if asked.sent >= _MOST_SENT:
                with suppress(TimeoutError):
                    message = await self._hear(heard, unit, block, began + self._timeout_s / 2, wait_s)
            if message is None:
                self._stream.write(rtu_request(unit, block))
                asked.sent += 1
                if asked.sent == 1:
                    asked.since_s, wait_s = began, self._patience.wait_s(unit, block)
                message = await self._hear(heard, unit, block, began + self._timeout_s, wait_s)
        except TimeoutError:
            self._owing_until = None
            self._missed(unit, block, heard)
            raise self._nothing_valid(device, unit, block, heard, wait_s) from None
        except asyncio.CancelledError:
            asked.over = True
            raise
        finally:
            self._quiet_since = loop.time()
        # Of several equal requests the first may have been answered: it is slow rather than lost.
        self._patience.answered(unit, block, min(self._timeout_s, loop.time() - asked.since_s))
        await self._settle(unit, block, heard)
        self._owing_until = None
        return _decode(message, self._name, device)

    async def _hear(self, heard: bytearray, unit: int, block: Block, latest_s: float, wait_s: float) -> bytes:
        """The answer, once it is complete in `heard`.

        latest_s: loop time; wait_s: for the first byte, and for each that follows

        Raises TimeoutError.
        """
        loop = asyncio.get_running_loop()
        until = min(latest_s, loop.time() + wait_s)
        request = rtu_request(unit, block)
        while (message := find_rtu_answer(heard, unit, block)) is None:
            heard += await self._stream.read(until - loop.time())
            self._skip_echo(heard, request, unit, block)
            # Lets an answer that has begun finish; one that is complete and not valid is damaged.
            rest_s = self._pause_s if is_damaged(heard, block) else wait_s
            until = min(latest_s, loop.time() + rest_s)
        if self._echo is None:
            self._echo = False
        return message

    def _skip_echo(self, heard: bytearray, request: bytes, unit: int, block: Block) -> None:
        """Take the request itself from what was heard, unless it may be the answer of a line without echo."""
        if heard.startswith(request) and (self._echo or not find_rtu_answer(request, unit, block)):
            self._echo = True
            del heard[: len(request)]

    async def _settle(self, unit: int, block: Block, heard: bytearray) -> None:
        """The block is answered: let the answers to the other requests for it pass, which follow at once."""
        asked = self._unanswered.asked(unit, block)
        found = sum(1 for _ in rtu_answers(heard, unit, block))
        with suppress(TimeoutError):
            while found < asked.sent:
                heard += await self._stream.read(_FOLLOWS_S)
                found = sum(1 for _ in rtu_answers(heard, unit, block))
        asked.sent -= found
        self._unanswered.settle(unit, block)
        self._unanswered.note(heard, unit, block)

    def _missed(self, unit: int, block: Block, heard: bytearray) -> None:
        asked = self._unanswered.asked(unit, block)
        if is_damaged(heard, block):  # it has come: nothing is due
            asked.sent -= 1
            if not asked.sent:
                self._unanswered.settle(unit, block)
        else:
            self._patience.missed(unit)
        self._unanswered.note(heard, unit, block)

    async def _wait_for_owed_answer(self) -> None:
        """Let the unit finish answering a cancelled request; otherwise two would talk at once."""
        if self._owing_until is None:
            return
        deadline = self._owing_until
        loop = asyncio.get_running_loop()
        heard = bytearray()
        try:
            while True:
                heard += await self._stream.read(deadline - loop.time())
                deadline = min(deadline, loop.time() + self._pause_s)
        except TimeoutError:
            self._unanswered.note(heard)
            self._owing_until = None

    def _nothing_valid(
        self, device: str, unit: int, block: Block, heard: bytes | bytearray, waited_s: float
    ) -> NoAnswer | BadAnswer:
        is_late = self._unanswered.was_heard(unit)
        if not heard:
            return self._silence(device, unit, waited_s, heard=is_late)
        return BadAnswer(
            f"{len(heard)} bytes received, but no valid answer of unit {unit}: {heard[:16].hex(' ')}",
            heard=is_late or plausibly_of(heard, unit, block),
            bus=self._name,
            device=device,
            hint="two units with one id, wrong baud or parity, missing termination, or noise",
        )


class ModbusTcpBus(ModbusBus):
    """Units behind one host. Answers carry the request's number, which identifies late and foreign ones.

    Some hosts close the connection after each answer, or when nobody asks for a while. It is then opened anew for the
    next request, and once more when the host closes it while that is under way.
    """

    kind = "modbus_tcp"
    units = (0, 255)

    def __init__(self, name: str, settings: ModbusTcpSettings, tap: Tap | None = None) -> None:
        super().__init__(name, TcpStream(name, settings.host, settings.port, tap), settings.timeout_s)
        self._number = 0
        self._perhaps_busy_until, self._mute = 0.0, False
        self._sent: dict[tuple[int, Block], dict[int, float]] = {}
        """Requests whose answers are as good as the next one's, as the question has not changed: number and time."""
        self._wanted = False
        """Whether the connection is to be open: `connect` succeeded and nobody has called `close`."""

    def _opened(self) -> None:
        self._perhaps_busy_until, self._mute = 0.0, False
        self._sent = {}
        self._wanted = True

    async def close(self) -> None:
        self._wanted = False
        await super().close()

    async def _answer(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        if self._wanted and not self._stream.is_open:
            await self._open()
        try:
            return await self._exchange(device, unit, block, again)
        except ConnectError:
            if not self._wanted:
                raise
        await self._open()
        return await self._exchange(device, unit, block, again)

    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        heard = bytearray(self._stream.discard())
        if not again:
            heard.clear()
            self._sent = {key: numbers for key, numbers in self._sent.items() if key[0] != unit}
        sent = self._sent.setdefault((unit, block), {})
        loop = asyncio.get_running_loop()
        began = loop.time()
        found = _any_answer(heard, sent)
        if found is None:
            self._number = self._number % 0xFFFF + 1
            pdu = request_pdu(block)
            self._stream.write(TCP_HEADER.pack(self._number, 0, len(pdu) + 1, unit) + pdu)
            sent[self._number] = began
        wait_s = self._patience.wait_s(unit, block)
        # A gateway asks its units one after the other, and may be waiting for a silent one.
        if began < self._perhaps_busy_until or len(sent) > 1:
            wait_s = self._timeout_s
        until = began + wait_s
        try:
            while found is None:
                del heard[:-_MOST_HEARD]
                heard += await self._stream.read(until - loop.time())
                until = min(began + self._timeout_s, loop.time() + wait_s)  # lets an answer that has begun finish
                found = _any_answer(heard, sent)
        except TimeoutError:
            self._patience.missed(unit)
            # Not a byte within the full timeout, not even of a late answer: this is not a busy gateway.
            self._mute = not heard and (self._mute or wait_s >= self._timeout_s)
            self._perhaps_busy_until = 0.0 if self._mute else loop.time() + self._timeout_s
            raise self._nothing_valid(device, unit, heard, wait_s) from None
        self._perhaps_busy_until, self._mute = 0.0, False
        del self._sent[unit, block]
        number, answering, answer = found
        if answering == unit and answer[0] == block.function:
            self._patience.answered(unit, block, min(self._timeout_s, loop.time() - sent[number]))
        self._check(device, unit, block, answering, answer)
        return _decode(answer, self._name, device)

    def _check(self, device: str, unit: int, block: Block, answering: int, answer: bytes) -> None:
        """Raises BadAnswer if it is not that unit's answer to that request."""
        if answering != unit:
            raise BadAnswer(f"unit {answering} answered instead of unit {unit}", bus=self._name, device=device)
        if not fits(answer, block):
            raise BadAnswer(
                f"the answer does not fit function {block.function}, count {block.count}: {answer[:16].hex(' ')}",
                bus=self._name,
                device=device,
            )

    def _nothing_valid(self, device: str, unit: int, heard: bytes | bytearray, waited_s: float) -> NoAnswer | BadAnswer:
        if tcp_messages(heard)[1] == len(heard):  # nothing, or late answers only
            return self._silence(device, unit, waited_s)
        return BadAnswer(
            f"the bytes received are not a complete Modbus TCP answer: {heard[:16].hex(' ')}",
            bus=self._name,
            device=device,
            hint="check host and port; is the device's serial side disturbed?",
        )


def _any_answer(heard: bytearray, numbers: Iterable[int]) -> tuple[int, int, bytes] | None:
    """Number, unit and message of the answer to one of these requests."""
    return next(((n, *answer) for n in numbers if (answer := find_tcp_answer(heard, n)) is not None), None)


def _decode(message: bytes, bus: str, device: str) -> ModbusPDU:
    try:
        pdu = _DECODER.decode(message)
    except (ModbusException, ValueError, struct.error, IndexError) as error:
        raise BadAnswer(f"cannot be decoded: {error}: {message.hex(' ')}", bus=bus, device=device) from error
    if pdu is None:
        raise BadAnswer(f"cannot be decoded: {message.hex(' ')}", bus=bus, device=device)
    return pdu
