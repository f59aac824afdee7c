"""The base of the Modbus buses, and Modbus TCP: one request, one answer. A late or foreign answer is never accepted.

pymodbus encodes and decodes the messages and checksums. Its client is not used: after a timeout or a cancelled await it
hands the late answer to the next RTU request, and one dead unit behind a gateway makes it close the connection that
other units share. Sources: MODBUS Application Protocol V1.1b3; MODBUS over serial line V1.02.
"""

import asyncio
import struct
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from contextlib import suppress
from math import ceil, inf, isinf

from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.byte_stream import ByteStream, StreamBus, TcpStream
from drivers.modbus.frames import (
    RESPONSES,
    TCP_HEADER,
    begins_message,
    find_tcp_answer,
    fits,
    is_refusal,
    request_pdu,
    tcp_messages,
)
from drivers.modbus.numbers import BIT_FUNCTIONS, Block
from drivers.modbus.refusals import is_busy, is_target_silent, refusal
from drivers.modbus.settings import LONGEST_SETTLE_S, AskedSettings, ModbusTcpSettings, ServerSettings
from drivers.patience import Patience
from drivers.requests import Came, Requests
from drivers.rests import Rests
from drivers.tap import Tap
from drivers.text import Text, Value

_MOST_REOPENED = 2
"""So often for one question, which may take two requests."""
_AT_ONCE_S = 0.01
"""A host that closes a new connection so soon does not want it; one that does so later closes what is idle."""
_MOST_SENT = 2
"""How often a silent unit is sent one question before its late answer is waited for: more would slow it down."""
_SHORTEST_S = 0.03
"""A request that must be answered sooner than this is not sent: its answer would disturb the next period."""
_LONG_REST_S = 0.15
DOES_NOT_FIT = Text("profile_fits")
_LATE = Text("modbus_later")
_MOST_BEHIND = 4
"""So often in a row a server may answer only earlier requests, until the connection is opened again."""
_STRIDE = 2
"""Between the numbers of two requests: a server that answers with the next number never hits another request's."""
_ALIEN = 3
"""So many answers in a row must have a number that no request had, until the server is known to give its own."""
_GIVEN_UP_S = 5.0
"""How long none is after that was in vain."""
_MOST_HEARD = 4096
"""How many bytes are searched for the answer to one request."""


class NotAsked(NoAnswer):
    """The request was not sent: no time was left, or the answer to an earlier one is still waited for."""


class ModbusBus(StreamBus, ABC):
    """A connection that several units share.

    It leads each request through its life (`Requests`): the unit is left to rest, the line becomes quiet, the request
    is sent and waited for about as long as the unit usually takes (`Patience`). One that was missed is sent once more,
    or its late answer is waited for, whichever has brought answers of this unit before.
    """

    kind: str
    units: tuple[int, int]
    carries: str | None = None
    has_checksum = False
    """Whether a changed byte in a frame is noticed."""
    has_numbers = False
    """Whether an answer carries the number of its request."""
    reopens = False
    """Whether a connection that the other side closed is opened again for the next request, and again when it is
    closed while that is under way: some hosts close it after each answer, or when nobody asks for a while."""

    def __init__(self, name: str, settings: AskedSettings, stream: ByteStream, patience: Patience) -> None:
        super().__init__(name, stream, settings.timeout_s)
        self._settings, self._patience = settings, patience
        self._rests = Rests(settings.settle_s, settings.rest_ms / 1e3)
        self._requests = Requests[Block](numbered=self.has_numbers)
        self._until_s, self._sent_s = inf, -inf
        self._is_repeated = False
        """Whether the question that is under way is."""
        self._longer_in_vain_s = -inf
        """When an answer was last waited for longer than the timeout, and did not come."""
        self._wanted = False
        """Whether the connection is to be open: `connect` succeeded and nobody has called `close`."""
        self._learnt: dict[tuple[str, int], Text] = {}
        """By code and unit; 0: it is about the connection."""

    async def connect(self) -> None:
        """Open the connection and let it settle, unless it is open already. Raises ConnectError."""
        async with self._lock:
            if not self._stream.is_open:
                await self._open()
                await asyncio.sleep(self._settings.settle_s)

    async def end_period(self) -> None:
        """Let others connect until the next request, where the settings say so."""
        if isinstance(self._settings, ServerSettings) and self._settings.close_between_polls:
            async with self._lock:
                await self._stream.close()

    def let_rest(self, unit: int, least_s: float) -> None:
        """The unit is never asked sooner than this after an answer."""
        self._rests.state(unit, least_s)

    def learnt(self) -> Collection[Text]:
        """What is certain and not stated: when it may be asked, each with the key that states it."""
        mute_s = ceil(10 * self._rests.mute_s) / 10
        if self._settings.settle_s < mute_s <= LONGEST_SETTLE_S and self.reopens:
            self._learn("modbus_mute", 0, settle_s=mute_s)
        for unit, rest_s in self._rests.needed_s.items():
            self._learn("needs_rest", unit, rest_ms=round(1e3 * rest_s))
        return self._learnt.values()

    def answers_s(self) -> Mapping[int, float]:
        return self._patience.usual_s()

    def learn_whole(self, unit: int, where: Text) -> None:
        """The unit refuses parts of what it returns as a whole."""
        self._learn("modbus_whole", unit, where=where)

    def _learn(self, code: str, about: int, **values: Value) -> None:
        if (code, about) not in self._learnt:
            self._learnt[code, about] = Text(code, bus=self._name, **({"unit": about} if about else {}), **values)

    async def close(self) -> None:
        self._wanted = False
        await super().close()

    def limit(self, left_s: float) -> None:
        self._until_s = asyncio.get_running_loop().time() + left_s

    @property
    def left_s(self) -> float:
        """How long a request may wait until the limit."""
        return inf if isinf(self._until_s) else self._until_s - asyncio.get_running_loop().time()

    def is_late(self, unit: int) -> bool:
        """Whether answers of the unit that were missed usually come in the end."""
        return self._requests.is_late(unit)

    async def read(self, device: str, unit: int, block: Block, *, again: bool = False) -> tuple[int, ...]:
        """Registers (0..65535) or bits (0, 1) of one block.

        again: this repeats a question to the unit, so an answer to the earlier one is accepted too

        Raises NoAnswer, BadAnswer, Refused (exception code), Busy or ConnectError (wire lost).
        """
        async with self._lock:
            self._is_repeated = again
            pdu = decode_pdu(await self._answer(device, unit, block, again), self._name, device)
        if isinstance(pdu, ExceptionResponse):
            raise refusal(self._name, device, unit, block, pdu.exception_code)
        if block.function in BIT_FUNCTIONS:
            return tuple(int(bit) for bit in pdu.bits[: block.count])
        return tuple(pdu.registers)

    async def _open(self) -> None:
        await super()._open()
        self._wanted = True
        self._rests.opened(asyncio.get_running_loop().time())
        self._opened()

    async def _open_again(self) -> None:
        """A server with one client may need a moment until it has noticed that the last one is gone."""
        loop, pause_s = asyncio.get_running_loop(), _SHORTEST_S
        until_s = loop.time() + min(self._timeout_s, self.left_s)
        while True:
            try:
                await self._open()
            except ConnectError:
                if loop.time() + pause_s > until_s:
                    raise
            else:
                return
            await asyncio.sleep(pause_s)
            pause_s *= 2

    def _opened(self) -> None:
        """Reset what belonged to the last connection."""

    async def _answer(self, device: str, unit: int, block: Block, again: bool) -> bytes:
        """As `_exchange`, on a connection that may have to be opened again."""
        if self.left_s < _SHORTEST_S:
            raise NotAsked(Text("modbus_no_time", unit=unit), hurried=True, bus=self._name, device=device)
        if self.reopens and self._wanted and not self._stream.is_open:
            await self._open_again()
        opened_s = -inf
        for _ in range(_MOST_REOPENED):
            try:
                return await self._exchange(device, unit, block, again)
            except ConnectError:
                lasted_s = asyncio.get_running_loop().time() - opened_s
                at_once = lasted_s < _AT_ONCE_S and self._rests.line_answered_s < opened_s
                if at_once or not (self.reopens and self._wanted):
                    raise
            await self._open_again()
            opened_s, again = asyncio.get_running_loop().time(), True
        return await self._exchange(device, unit, block, again)

    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> bytes:
        """The answer (function code and data), which may be a refusal; one that has come already, if it is repeated."""
        self._requests.asked = 0
        await self._listen()
        self._requests.asked = unit
        if not again:
            self._requests.begin(unit, asyncio.get_running_loop().time())
        elif (came := self._requests.took(unit, block)) is not None:
            self._check(device, unit, block, came)
            self._rests.heard(unit, came.sent_s)
            return came.message
        came = await self._asked(device, unit, block)
        self._check(device, unit, block, came)
        self._rests.heard(unit, came.sent_s)
        return came.message

    def _check(self, device: str, unit: int, block: Block, came: Came) -> None:
        """Raises BadAnswer if it is not that unit's answer to that request."""

    async def _listen(self) -> None:
        """Hear what has come since the last request."""
        self._sort(bytearray(self._stream.discard()), 0)

    @abstractmethod
    def _sort(self, heard: bytearray, start: int) -> int:
        """Give each answer in what was heard, from there on, to its request; returns the end of the last one."""

    async def _asked(self, device: str, unit: int, block: Block) -> Came:
        """The answer to the request, which is certainly its own."""
        return await self._request(device, unit, block, block)

    async def _let_rest(self, device: str, unit: int) -> None:
        """Wait for as long as the unit needs after its last answer; only so long as time is left to ask it then. For a
        long rest the others are asked before it: it must not take the time of their next period."""
        rest_s = self._rests.left_s(unit, asyncio.get_running_loop().time(), first=isinf(self.left_s))
        if rest_s <= 0:
            return
        is_first = isinf(self.left_s) and not self._is_repeated
        if self.left_s - rest_s < _SHORTEST_S or (is_first and rest_s >= _LONG_REST_S and self._rests.are_several):
            code = "modbus_unit_busy" if self._rests.is_busy(unit) else "modbus_unit_rests"
            what = Text(code, unit=unit)
            raise NotAsked(what, hurried=True, heard=True, bus=self._name, device=device)
        await asyncio.sleep(rest_s)

    async def _request(self, device: str, unit: int, block: Block, like: Block) -> Came:
        """Send the request and wait about as long as the unit usually takes for the one that it is like.

        Raises NoAnswer or BadAnswer.
        """
        loop, requests = asyncio.get_running_loop(), self._requests
        await self._let_rest(device, unit)
        await self._quieten(unit, block)
        began_s = loop.time()
        longest_s = self._longest_s(unit)
        wait_s = min(self._wait_s(unit, like) if longest_s == self._timeout_s else longest_s, self.left_s)
        latest_s = began_s + min(longest_s, self.left_s)
        heard = bytearray()
        try:
            came = await self._send_or_wait(device, unit, block, like, heard, latest_s, wait_s)
        except ConnectError:
            if not heard:
                self._rests.missed(unit, loop.time())
            raise
        except TimeoutError:
            if longest_s > self._timeout_s and loop.time() >= latest_s:
                self._longer_in_vain_s = loop.time()
            if not (heard or requests.is_late(unit)):
                self._rests.missed(unit, loop.time())
            if not heard and self._sent_s < began_s:
                is_late = requests.was_heard(unit)
                raise self._silence(device, unit, wait_s, heard=is_late, kind=NotAsked) from None
            requests.missed(unit, block)
            return Came(unit, await self._missed(device, unit, block, like, heard, wait_s), began_s)
        answered_s = loop.time()
        await self._answered(unit, block, came, heard)
        # If each of several equal requests was answered, the unit is slow; otherwise an answer was lost.
        still_open = [] if self.has_numbers else requests.open(unit, block)
        sent_s = still_open[-1].sent_s if still_open else came.sent_s
        if came.unit == unit and came.message[:1] == bytes((block.function,)):
            self._patience.answered(unit, like, min(self._timeout_s, answered_s - sent_s))
        self._tell_rests(unit, came.message, answered_s)
        return came

    async def _send_or_wait(
        self, device: str, unit: int, block: Block, like: Block, heard: bytearray, latest_s: float, wait_s: float
    ) -> Came:
        """The answer to this request, or to one for the same that was sent before, late as it is.

        Raises TimeoutError, or NotAsked if the answer would not come in time.
        """
        requests, now_s = self._requests, asyncio.get_running_loop().time()
        waiting = requests.open(unit, block, old=block != like)
        if waiting and (again_s := waiting[-1].sent_s + requests.patience_s(unit)) > now_s:
            return await self._hear(heard, unit, block, like, min(again_s, latest_s), again_s - now_s)
        if len(waiting) >= _MOST_SENT:
            with suppress(TimeoutError):
                return await self._hear(heard, unit, block, like, now_s + wait_s / 2, wait_s)
        if self.left_s < requests.least_s(unit):
            raise self._silence(device, unit, self._timeout_s, heard=True, kind=NotAsked)
        self._sent_s = asyncio.get_running_loop().time()
        self._rests.sent(unit, self._sent_s)
        self._send(unit, block)
        return await self._hear(heard, unit, block, like, latest_s, wait_s)

    def _tell_rests(self, unit: int, message: bytes, now_s: float) -> None:
        self._rests.line_answered_s = now_s
        if is_target_silent(message):
            self._rests.not_reached(unit, now_s)
        elif is_busy(message):
            self._rests.was_busy(unit, now_s)
        else:
            self._rests.answered(unit, now_s)

    def _longest_s(self, unit: int) -> float:
        """How long an answer of the unit may take: longer than the timeout where each answer of each unit does, which
        would otherwise never come before the next question."""
        is_vain = asyncio.get_running_loop().time() < self._longer_in_vain_s + _GIVEN_UP_S
        if is_vain or not self._requests.all_slower(self._timeout_s):
            return self._timeout_s
        return self._patience.late_s(self._requests.patience_s(unit))

    def _wait_s(self, unit: int, like: Block) -> float:
        """How long the first byte of the answer is waited for."""
        return self._patience.wait_s(unit, like)

    async def _quieten(self, unit: int, block: Block) -> None:
        """Wait until a request may be sent on the line."""

    @abstractmethod
    def _send(self, unit: int, block: Block) -> None: ...

    @abstractmethod
    async def _hear(
        self, heard: bytearray, unit: int, block: Block, like: Block, latest_s: float, wait_s: float
    ) -> Came:
        """The answer, once it is complete in `heard`.

        latest_s: loop time; wait_s: for the first byte, and for each that follows

        Raises TimeoutError.
        """

    async def _answered(self, unit: int, block: Block, came: Came, heard: bytearray) -> None:
        """What follows an answer."""

    @abstractmethod
    async def _missed(
        self, device: str, unit: int, block: Block, like: Block, heard: bytearray, waited_s: float
    ) -> bytes:
        """Nothing valid has come. Raises NoAnswer or BadAnswer, unless it is an answer after all."""

    def _silence(
        self, device: str, unit: int, waited_s: float, *, heard: bool = False, kind: type[NoAnswer] = NoAnswer
    ) -> NoAnswer:
        return kind(
            Text("modbus_unit_silent", unit=unit, waited_s=waited_s),
            hurried=waited_s < self._timeout_s,
            heard=heard,
            bus=self._name,
            device=device,
            hint=_LATE if heard else Text("check_unit"),
        )


class ModbusTcpBus(ModbusBus):
    """Units behind one host. Answers carry the request's number, which identifies late and foreign ones."""

    kind = ModbusTcpSettings.bus_kind
    units = ModbusTcpSettings.units
    has_numbers = True
    reopens = True

    def __init__(self, name: str, settings: ModbusTcpSettings, tap: Tap | None = None) -> None:
        stream = TcpStream(name, settings.host, settings.port, tap)
        super().__init__(name, settings, stream, Patience(settings.timeout_s))
        self._number = 1 - _STRIDE
        self._perhaps_busy_until, self._mute = 0.0, False
        self._behind = 0
        """How many requests in a row were answered only by answers to earlier ones."""
        self._alien = 0
        """How many answers in a row had a number that no request can have had."""

    def _opened(self) -> None:
        self._perhaps_busy_until, self._mute = 0.0, False
        self._behind = 0
        self._requests.clear()

    def _sort(self, heard: bytearray, start: int) -> int:
        now_s = asyncio.get_running_loop().time()
        for number in self._requests.numbers:
            if (answer := find_tcp_answer(heard, number)) is not None:
                self._requests.came(*answer, now_s, number)
        return start

    def _wait_s(self, unit: int, like: Block) -> float:
        # A gateway asks its units one after the other, and may be waiting for a silent one.
        is_busy_perhaps = asyncio.get_running_loop().time() < self._perhaps_busy_until
        is_late = is_busy_perhaps or bool(self._requests.open(unit, like))
        return self._timeout_s if is_late else super()._wait_s(unit, like)

    def _send(self, unit: int, block: Block) -> None:
        self._number = (self._number + _STRIDE) % 0x10000
        pdu = request_pdu(block)
        self._stream.write(TCP_HEADER.pack(self._number, 0, len(pdu) + 1, unit) + pdu)
        self._requests.sent(unit, block, asyncio.get_running_loop().time(), self._number)

    async def _hear(self, heard: bytearray, unit: int, block: Block, _: Block, latest_s: float, wait_s: float) -> Came:
        loop = asyncio.get_running_loop()
        until = min(latest_s, loop.time() + wait_s)
        while (came := self._requests.took(unit, block)) is None:
            del heard[:-_MOST_HEARD]
            heard += await self._stream.read(until - loop.time())
            until = min(latest_s, loop.time() + wait_s)  # lets an answer that has begun finish
            self._sort(heard, 0)
        return came

    async def _answered(self, unit: int, block: Block, came: Came, heard: bytearray) -> None:  # noqa: ARG002
        self._perhaps_busy_until, self._mute = 0.0, False
        self._alien = 0
        self._behind = 0 if came.number == self._number else self._behind + 1
        self._requests.was_heard(unit)

    async def _missed(
        self,
        device: str,
        unit: int,
        block: Block,  # noqa: ARG002
        like: Block,  # noqa: ARG002
        heard: bytearray,
        waited_s: float,
    ) -> bytes:
        loop = asyncio.get_running_loop()
        self._patience.missed(unit)
        await self._reopen_if_behind(heard)
        # Not a byte within the full timeout, not even of a late answer: this is not a busy gateway.
        self._mute = not heard and (self._mute or waited_s >= self._timeout_s)
        self._perhaps_busy_until = 0.0 if self._mute else loop.time() + self._timeout_s
        raise self._nothing_valid(device, unit, heard, waited_s)

    async def _reopen_if_behind(self, heard: bytearray) -> None:
        """Close a connection on which each answer is an earlier request's, again and again: a new one is in order."""
        messages, end = tcp_messages(heard)
        numbers = [number for number, _, _ in messages]
        self._behind += bool(numbers) and end == len(heard) and self._number not in numbers
        if self._behind >= _MOST_BEHIND:
            await self._stream.close()

    def _check(self, device: str, unit: int, block: Block, came: Came) -> None:
        answering, answer = came.unit, came.message
        if answering != unit:
            raise BadAnswer(
                Text("modbus_other_unit", other=answering, unit=unit),
                bus=self._name,
                device=device,
                hint=Text("modbus_ask_as", other=answering),
            )
        if not (fits(answer, block) or is_refusal(answer)):  # some refuse with another function's code
            raise BadAnswer(
                Text("modbus_does_not_fit", function=block.function, count=block.count, bytes=answer[:16].hex(" ")),
                bus=self._name,
                device=device,
                hint=DOES_NOT_FIT,
            )

    def _nothing_valid(self, device: str, unit: int, heard: bytes | bytearray, waited_s: float) -> NoAnswer | BadAnswer:
        messages, end = tcp_messages(heard)
        is_late = self._requests.was_heard(unit)
        if not heard:
            return self._silence(device, unit, waited_s, heard=is_late)
        if end == len(heard):
            self._alien += sum(number % _STRIDE == 0 for number, _, _ in messages)
            if self._alien >= _ALIEN:
                self._learn("modbus_own_numbers", 0)
            others = ", ".join(str(number) for number, _, _ in messages)
            return NoAnswer(
                Text("modbus_request_silent", unit=unit, number=self._number, waited_s=waited_s, others=others),
                hurried=waited_s < self._timeout_s,
                heard=is_late or any(answering == unit for _, answering, _ in messages),
                bus=self._name,
                device=device,
                hint=_LATE if is_late else Text("modbus_number_own"),
            )
        return BadAnswer(
            _header_fault(heard[end:]),
            bus=self._name,
            device=device,
            hint=Text("modbus_check_server"),
        )


def _header_fault(heard: bytes | bytearray) -> Text:
    """Which field of the header is wrong in bytes that are not a message."""
    told = heard[:16].hex(" ")
    if begins_message(heard):
        return Text("modbus_incomplete", bytes=told)
    _, protocol, length, _ = TCP_HEADER.unpack_from(heard)
    if protocol:
        return Text("modbus_protocol", protocol=protocol, bytes=told)
    return Text("modbus_length", length=length, bytes=told)


def decode_pdu(message: bytes, bus: str, device: str) -> ModbusPDU:
    """The answer, from its function code and data. Raises BadAnswer."""
    try:
        # Not by pymodbus' DecodePDU, which writes each answer as text for its log, whatever is logged.
        refused, function = message[0] & 0x80, message[0] & 0x7F
        pdu = ExceptionResponse(function) if refused else RESPONSES[function]()
        pdu.decode(message[1:])
    except (ModbusException, ValueError, struct.error, IndexError) as error:
        raise BadAnswer(
            Text("modbus_undecodable", error=str(error), bytes=message.hex(" ")), bus=bus, device=device
        ) from error
    return pdu
