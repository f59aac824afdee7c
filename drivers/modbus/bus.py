"""The base of the Modbus buses, and Modbus TCP: one request, one answer. A late or foreign answer is never accepted.

pymodbus encodes and decodes the messages and checksums. Its client is not used: after a timeout or a cancelled await it
hands the late answer to the next RTU request, and one dead unit behind a gateway makes it close the connection that
other units share. Sources: MODBUS Application Protocol V1.1b3; MODBUS over serial line V1.02.
"""

import asyncio
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable
from math import inf, isinf

from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.base import BadAnswer, Busy, ConnectError, NoAnswer
from drivers.byte_stream import ByteStream, StreamBus, TcpStream
from drivers.modbus.frames import (
    RESPONSES,
    TCP_HEADER,
    find_tcp_answer,
    fits,
    is_refusal,
    request_pdu,
    tcp_messages,
)
from drivers.modbus.numbers import BIT_FUNCTIONS, Block
from drivers.modbus.refusals import is_target_silent, refusal
from drivers.modbus.rests import MinimumRests, Rests
from drivers.modbus.settings import ModbusTcpSettings
from drivers.patience import Patience
from drivers.tap import Tap

_SHORTEST_S = 0.03
"""A request that must be answered sooner than this is not sent: its answer would disturb the next period."""
DOES_NOT_FIT = "does the profile fit the device?"
_LATE = "it answers later: raise timeout_s"
_MOST_BEHIND = 4
"""So often in a row a server may answer only earlier requests, until the connection is opened again."""
_MOST_HEARD = 4096
"""How many bytes are searched for the answer to one request."""


class NotAsked(NoAnswer):
    """No time was left to send the request."""


class ModbusBus(StreamBus, ABC):
    """A connection that several units share."""

    kind: str
    units: tuple[int, int]
    carries: str | None = None
    has_checksum = False
    """Whether a changed byte in a frame is noticed."""
    reopens = False
    """Whether a connection that the other side closed is opened again for the next request, and once more when it is
    closed while that is under way: some hosts close it after each answer, or when nobody asks for a while."""

    def __init__(self, name: str, stream: ByteStream, patience: Patience, timeout_s: float) -> None:
        super().__init__(name, stream, timeout_s)
        self._patience = patience
        self._until_s = inf
        self._rests, self._minimum = Rests(), MinimumRests()
        self._wanted = False
        """Whether the connection is to be open: `connect` succeeded and nobody has called `close`."""

    async def close(self) -> None:
        self._wanted = False
        await super().close()

    def limit(self, left_s: float) -> None:
        self._until_s = asyncio.get_running_loop().time() + left_s

    @property
    def left_s(self) -> float:
        """How long a request may wait until the limit."""
        return inf if isinf(self._until_s) else self._until_s - asyncio.get_running_loop().time()

    async def read(self, device: str, unit: int, block: Block, *, again: bool = False) -> tuple[int, ...]:
        """Registers (0..65535) or bits (0, 1) of one block.

        again: this repeats a question to the unit, so an answer to the earlier one is accepted too

        Raises NoAnswer, BadAnswer, Refused (exception code), Busy or ConnectError (wire lost).
        """
        async with self._lock:
            await self._let_rest(device, unit, again)
            pdu = await self._answer(device, unit, block, again)
        if isinstance(pdu, ExceptionResponse):
            error = refusal(self._name, device, unit, block, pdu.exception_code)
            if isinstance(error, Busy):
                self._rests.was_busy(unit, asyncio.get_running_loop().time())
            raise error
        self._rests.answered(unit)
        if block.function in BIT_FUNCTIONS:
            return tuple(int(bit) for bit in pdu.bits[: block.count])
        return tuple(pdu.registers)

    async def _open(self) -> None:
        await super()._open()
        self._wanted = True
        self._opened()

    def _opened(self) -> None:
        """Reset what belonged to the last connection."""

    async def _let_rest(self, device: str, unit: int, again: bool) -> None:
        """Wait before a question is repeated to a unit that was busy; only so long as time is left to ask it then."""
        if not again:
            self._rests.answered(unit)
            return
        rest_s = self._rests.left_s(unit, asyncio.get_running_loop().time())
        if rest_s <= 0:
            return
        if self.left_s - rest_s < _SHORTEST_S:
            raise NotAsked(
                f"unit {unit} is busy, and no time was left to ask it later",
                hurried=True,
                heard=True,
                bus=self._name,
                device=device,
            )
        await asyncio.sleep(rest_s)

    async def _let_settle(self, device: str, unit: int) -> None:
        """Wait for as long as the unit needs after its last answer; call it just before a request is sent."""
        loop = asyncio.get_running_loop()
        if (rest_s := self._minimum.left_s(unit, loop.time(), first=isinf(self.left_s))) > 0:
            if self.left_s - rest_s < _SHORTEST_S:
                what = f"unit {unit} needs a rest after each answer, and no time was left to ask it then"
                raise NotAsked(what, hurried=True, heard=True, bus=self._name, device=device)
            await asyncio.sleep(rest_s)

    async def _answer(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        """As `_exchange`, on a connection that may have to be opened again."""
        if self.left_s < _SHORTEST_S:
            raise NotAsked(
                f"unit {unit}: no time was left to ask for all its values", hurried=True, bus=self._name, device=device
            )
        if self.reopens and self._wanted and not self._stream.is_open:
            await self._open()
        try:
            return await self._exchange(device, unit, block, again)
        except ConnectError:
            if not (self.reopens and self._wanted):
                raise
        await self._open()
        return await self._exchange(device, unit, block, again=True)

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
            hint=_LATE if heard else "check power, wiring, unit id and baud",
        )


class ModbusTcpBus(ModbusBus):
    """Units behind one host. Answers carry the request's number, which identifies late and foreign ones."""

    kind = ModbusTcpSettings.bus_kind
    units = ModbusTcpSettings.units
    reopens = True

    def __init__(self, name: str, settings: ModbusTcpSettings, tap: Tap | None = None) -> None:
        stream = TcpStream(name, settings.host, settings.port, tap)
        super().__init__(name, stream, Patience(settings.timeout_s), settings.timeout_s)
        self._number = 0
        self._perhaps_busy_until, self._mute = 0.0, False
        self._behind = 0
        """How many requests in a row were answered only by answers to earlier ones."""
        self._sent: dict[tuple[int, Block], dict[int, float]] = {}
        """Requests whose answers are as good as the next one's, as the question has not changed: number and time."""
        self._late: set[int] = set()
        """Units of which late answers to earlier questions have come since they were found missing."""

    def _opened(self) -> None:
        self._perhaps_busy_until, self._mute = 0.0, False
        self._behind = 0
        self._sent = {}
        self._late.clear()

    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        heard = bytearray(self._stream.discard())
        if not again:
            self._note_late(heard)
            heard.clear()
            self._sent = {key: numbers for key, numbers in self._sent.items() if key[0] != unit}
        sent = self._sent.setdefault((unit, block), {})
        loop = asyncio.get_running_loop()
        began = loop.time()
        found = _any_answer(heard, sent)
        if found is None:
            await self._let_settle(device, unit)
            began = loop.time()
            self._minimum.sent(unit, began)
            self._number = self._number % 0xFFFF + 1
            pdu = request_pdu(block)
            self._stream.write(TCP_HEADER.pack(self._number, 0, len(pdu) + 1, unit) + pdu)
            sent[self._number] = began
        wait_s = self._patience.wait_s(unit, block)
        # A gateway asks its units one after the other, and may be waiting for a silent one.
        if began < self._perhaps_busy_until or len(sent) > 1:
            wait_s = self._timeout_s
        latest = began + min(self._timeout_s, self.left_s)
        wait_s = min(wait_s, latest - began)
        until = began + wait_s
        try:
            while found is None:
                del heard[:-_MOST_HEARD]
                heard += await self._stream.read(until - loop.time())
                until = min(latest, loop.time() + wait_s)  # lets an answer that has begun finish
                found = _any_answer(heard, sent)
        except TimeoutError:
            self._patience.missed(unit)
            if not heard:
                self._minimum.missed(unit, loop.time())
            await self._reopen_if_behind(heard)
            # Not a byte within the full timeout, not even of a late answer: this is not a busy gateway.
            self._mute = not heard and (self._mute or wait_s >= self._timeout_s)
            self._perhaps_busy_until = 0.0 if self._mute else loop.time() + self._timeout_s
            raise self._nothing_valid(device, unit, heard, wait_s) from None
        self._perhaps_busy_until, self._mute = 0.0, False
        self._late.discard(unit)
        del self._sent[unit, block]
        number, answering, answer = found
        self._behind = 0
        (self._minimum.refused if is_target_silent(answer) else self._minimum.answered)(unit, loop.time())
        if answering == unit and answer[0] == block.function:
            self._patience.answered(unit, block, min(self._timeout_s, loop.time() - sent[number]))
        self._check(device, unit, block, answering, answer)
        return decode_pdu(answer, self._name, device)

    async def _reopen_if_behind(self, heard: bytearray) -> None:
        """Close a connection on which each answer is an earlier request's, again and again: a new one is in order."""
        messages, end = tcp_messages(heard)
        is_behind = bool(messages) and end == len(heard) and self._number not in messages
        self._behind = self._behind + 1 if is_behind else 0
        if self._behind >= _MOST_BEHIND:
            await self._stream.close()

    def _note_late(self, heard: bytearray) -> None:
        for number, (unit, _) in tcp_messages(heard)[0].items():
            if any(number in numbers for (asked, _), numbers in self._sent.items() if asked == unit):
                self._late.add(unit)

    def _check(self, device: str, unit: int, block: Block, answering: int, answer: bytes) -> None:
        """Raises BadAnswer if it is not that unit's answer to that request."""
        if answering != unit:
            raise BadAnswer(
                f"unit {answering} answered instead of unit {unit}",
                bus=self._name,
                device=device,
                hint=f"if the host is a single device, ask it as unit {answering}",
            )
        if not (fits(answer, block) or is_refusal(answer)):  # some refuse with another function's code
            raise BadAnswer(
                f"the answer does not fit function {block.function}, count {block.count}: {answer[:16].hex(' ')}",
                bus=self._name,
                device=device,
                hint=DOES_NOT_FIT,
            )

    def _nothing_valid(self, device: str, unit: int, heard: bytes | bytearray, waited_s: float) -> NoAnswer | BadAnswer:
        messages, end = tcp_messages(heard)
        is_late = unit in self._late
        self._late.discard(unit)
        if not heard:
            return self._silence(device, unit, waited_s, heard=is_late)
        if end == len(heard):
            others = ", ".join(map(str, messages))
            return NoAnswer(
                f"unit {unit} did not answer request {self._number} within {waited_s:.3g} s, only answers to other "
                f"requests came ({others})",
                hurried=waited_s < self._timeout_s,
                heard=is_late or any(answering == unit for answering, _ in messages.values()),
                bus=self._name,
                device=device,
                hint="raise timeout_s; if the number is always the same, the server does not copy a request's number",
            )
        return BadAnswer(
            f"the bytes received are not a complete Modbus TCP answer: {heard[:16].hex(' ')}",
            bus=self._name,
            device=device,
            hint="check host and port; is the device's serial side disturbed?",
        )


def _any_answer(heard: bytearray, numbers: Iterable[int]) -> tuple[int, int, bytes] | None:
    """Number, unit and message of the answer to one of these requests."""
    return next(((n, *answer) for n in numbers if (answer := find_tcp_answer(heard, n)) is not None), None)


def decode_pdu(message: bytes, bus: str, device: str) -> ModbusPDU:
    """The answer, from its function code and data. Raises BadAnswer."""
    try:
        # Not by pymodbus' DecodePDU, which writes each answer as text for its log, whatever is logged.
        refused, function = message[0] & 0x80, message[0] & 0x7F
        pdu = ExceptionResponse(function) if refused else RESPONSES[function]()
        pdu.decode(message[1:])
    except (ModbusException, ValueError, struct.error, IndexError) as error:
        raise BadAnswer(f"cannot be decoded: {error}: {message.hex(' ')}", bus=bus, device=device) from error
    return pdu
