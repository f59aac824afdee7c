"""Modbus RTU on a serial line, and over TCP through a device server: frames with a checksum and without a number.

Source: MODBUS over serial line V1.02.
"""

import asyncio
from collections.abc import Collection
from contextlib import suppress

from pymodbus.pdu import ModbusPDU

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.byte_stream import ByteStream, TcpStream
from drivers.modbus.bus import DOES_NOT_FIT, ModbusBus, decode_pdu
from drivers.modbus.frames import (
    find_rtu_answer,
    foreign_refusal,
    is_damaged,
    is_rtu_frame,
    plausibly_of,
    rtu_answers,
    rtu_length,
    rtu_request,
)
from drivers.modbus.numbers import Block
from drivers.modbus.refusals import is_target_silent
from drivers.modbus.repeats import Repeats
from drivers.modbus.settings import ModbusRtuSettings, ModbusRtuTcpSettings
from drivers.modbus.strangers import Strangers
from drivers.modbus.unanswered import Unanswered
from drivers.patience import Patience
from drivers.serial_server import SERVER_PAUSE_S, pause_s, serial_stream
from drivers.tap import Tap

_MOST_SENT = 2
"""How often a silent unit is sent one question before its late answer is waited for: more would slow it down."""
_GROWTH = 2.0
"""Factor of the wait, each time a question is repeated. A wait that was too short costs one more request and no value,
as the late answer is as good."""
_MOST_CROSSED = 3
"""How often an answer that may be another master's is asked for again."""
_FOLLOWS_S = 0.05
"""How soon the answer to a repeated request follows the answer to the first one."""
_SERVER_GAP_S = 3.5 * 11 / 9600
"""Between frames behind a device server, whose line's speed is not known here; the network adds its own delay."""


class RtuFramedBus(ModbusBus):
    """Units on one line, or one connection. `Unanswered` says how late answers are distinguished from the next ones.

    Parameters
    ----------
    local_echo: whether each request is received before its answer; None: not known yet
    gap_s: silence between an answer and the next request
    pause_s: after a pause of this length, what was being sent has ended
    """

    units = ModbusRtuSettings.units
    has_checksum = True

    def __init__(
        self, name: str, stream: ByteStream, timeout_s: float, *, local_echo: bool | None, gap_s: float, pause_s: float
    ) -> None:
        super().__init__(name, stream, Patience(timeout_s, _GROWTH), timeout_s)
        self._gap_s, self._pause_s, self._echo = gap_s, pause_s, local_echo
        self._quiet_since = 0.0
        self._owing_until: float | None = None
        """Until when the answer to a cancelled request may come."""
        self._unanswered = Unanswered()
        self._strangers = Strangers()
        self._repeats = Repeats()
        self._crossed = False
        """Whether another master's request was heard just before the latest answer, which may be the answer to that."""

    def other_master(self) -> str:
        """What shows that another master is on the line, in words; empty if nothing does."""
        return self._strangers.evidence(asyncio.get_running_loop().time())

    def _opened(self) -> None:
        self._owing_until = None

    async def _exchange(self, device: str, unit: int, block: Block, again: bool) -> ModbusPDU:
        await self._wait_for_owed_answer()
        self._note(self._stream.discard())
        if not again:
            self._unanswered.begin(unit)
        elif (came := self._unanswered.took(unit, block)) is not None:
            return decode_pdu(came, self._name, device)
        separator = self._unanswered.separator(unit, block)
        if separator is None and self._echo is None and find_rtu_answer(rtu_request(unit, block), unit, block):
            # The request would be its own answer: learn from another one whether requests come back.
            separator = self._unanswered.another(unit, block)
        if separator is not None:
            await self._separate(device, unit, separator, block)
        await self._let_repetition_pass(unit, block)
        message = await self._request(device, unit, block, block)
        for _ in range(_MOST_CROSSED):
            if not self._crossed:
                break
            await self._separate(device, unit, self._unanswered.another(unit, block), block)
            message = await self._request(device, unit, block, block)
        if self._crossed:
            raise BadAnswer(
                f"another master asks unit {unit} for as many values, and it cannot be told whose the answers are",
                bus=self._name,
                device=device,
                hint="a line has one master; disconnect the other, or let it ask for another count",
            )
        now_s = asyncio.get_running_loop().time()
        if self._repeats.is_doubtful(unit, block, message, now_s):
            await self._separate(device, unit, self._unanswered.another(unit, block), block)
            message = await self._request(device, unit, block, block)
            self._repeats.checked(unit, block, message, now_s)
        self._repeats.accepted(unit, block, message, asyncio.get_running_loop().time())
        return decode_pdu(message, self._name, device)

    async def _separate(self, device: str, unit: int, separator: Block, like: Block) -> None:
        """Ask for something else first, so that nothing older can follow."""
        await self._request(device, unit, separator, like)
        self._unanswered.separated(unit)

    async def _let_repetition_pass(self, unit: int, block: Block) -> None:
        """Wait for a repetition that would look like the answer to this request."""
        loop = asyncio.get_running_loop()
        until_s = loop.time() + min(self._repeats.expected_s(unit, block, loop.time()), self.left_s)
        heard = bytearray()
        with suppress(TimeoutError):
            while loop.time() < until_s and not self._repeats.note(heard, loop.time(), self._unanswered.due):
                heard += await self._stream.read(until_s - loop.time())

    async def _request(self, device: str, unit: int, block: Block, like: Block) -> bytes:
        """Send the request and wait about as long as the unit usually takes for the one that it is like; the message
        that answers it (function code and data)."""
        loop = asyncio.get_running_loop()
        await self._let_settle(device, unit)
        if (gap_s := self._quiet_since + self._gap_s - loop.time()) > 0:
            await asyncio.sleep(gap_s)
        before = await self._let_others_be_answered(unit, block)
        self._strangers.asked(unit, block)
        asked = self._unanswered.asked(unit, block)
        began = loop.time()
        self._owing_until = began + self._timeout_s
        heard = bytearray()
        message: bytes | None = None
        habits = self._unanswered.habits
        wait_s = min(self._patience.wait_s(unit, like, longer=not habits.loses(unit)), self.left_s)
        latest_s = began + min(self._timeout_s, self.left_s)
        try:
            if asked.sent and (sent_again_s := asked.last_s + habits.patience_s(unit)) > began:
                message = await self._hear(heard, unit, block, min(sent_again_s, latest_s), wait_s)
            elif asked.sent >= _MOST_SENT:
                with suppress(TimeoutError):
                    message = await self._hear(heard, unit, block, began + wait_s / 2, wait_s)
            if message is None:
                self._minimum.sent(unit, loop.time())
                self._stream.write(rtu_request(unit, block))
                asked.sent += 1
                asked.last_s = loop.time()
                if asked.sent == 1:
                    asked.since_s = asked.last_s
                message = await self._hear(heard, unit, block, latest_s, wait_s)
        except TimeoutError:
            self._owing_until = None
            if (message := self._foreign_refusal(heard, unit)) is not None:
                self._came(unit, block)
                return message
            if not heard:
                self._minimum.missed(unit, loop.time())
            late = {other for other, due in self._unanswered.due if find_rtu_answer(heard, other, due)}
            self._missed(unit, block, like, heard)
            raise self._nothing_valid(device, unit, block, heard, wait_s, late) from None
        except asyncio.CancelledError:
            asked.over = True
            raise
        finally:
            self._quiet_since = loop.time()
        answered_s = loop.time()
        await self._look_for_others(unit, block, before + heard[: heard.find(bytes((unit,)) + message)], heard)
        (self._minimum.refused if is_target_silent(message) else self._minimum.answered)(unit, answered_s)
        all_came = await self._settle(unit, block, heard)
        # If each of several equal requests was answered, the unit is slow; otherwise an answer was lost.
        took_s = answered_s - (asked.since_s if all_came else asked.last_s)
        self._patience.answered(unit, like, min(self._timeout_s, took_s))
        self._owing_until = None
        return message

    async def _let_others_be_answered(self, unit: int, block: Block) -> bytes:
        """Wait for the answer to another master's request that looks like the one to this; returns the end of what was
        heard, which may be the beginning of such a request."""
        self._note(self._stream.discard())
        if self._strangers.waits(unit, block, asyncio.get_running_loop().time() - self._timeout_s):
            heard = bytearray()
            await self._let_pass(heard, min(self._timeout_s, self.left_s))
            self._note(heard)
        return self._strangers.tail

    async def _look_for_others(self, unit: int, block: Block, before: bytes, heard: bytearray) -> None:
        """Whether another master's request came before the answer, which may then be the answer to that."""
        self._crossed = self._strangers.asks(before, unit, block)
        if self._crossed:
            await self._let_pass(heard, self._pause_s)

    async def _let_pass(self, heard: bytearray, wait_s: float) -> None:
        """Hear what others are answered, and then a pause."""
        loop = asyncio.get_running_loop()
        until = loop.time() + wait_s
        with suppress(TimeoutError, ConnectError):
            while True:
                heard += await self._stream.read(until - loop.time())
                until = min(until, loop.time() + self._pause_s)

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
            # Lets an answer that has begun finish; one that is complete and not valid has ended.
            refused = self._foreign_refusal(heard, unit)
            new = refused is not None and not self._repeats.may_be_copy(unit, refused, loop.time())
            rest_s = self._pause_s if new or is_damaged(heard, block) else wait_s
            until = min(latest_s, loop.time() + rest_s)
        if self._echo is None:
            self._echo = False
        return message

    def _skip_echo(self, heard: bytearray, request: bytes, unit: int, block: Block) -> None:
        """Take the request itself from what was heard, unless it may be the answer of a line without echo."""
        if heard.startswith(request) and (self._echo or not find_rtu_answer(request, unit, block)):
            self._echo = True
            del heard[: len(request)]

    async def _settle(self, unit: int, block: Block, heard: bytearray) -> bool:
        """The block is answered: let the answers to the other requests for it pass, which follow at once.

        Returns whether all of them came.
        """
        asked = self._unanswered.asked(unit, block)
        found = sum(1 for _ in rtu_answers(heard, unit, block))
        with suppress(TimeoutError, ConnectError):  # an answer counts although the server hangs up after it
            while found < asked.sent:
                heard += await self._stream.read(_FOLLOWS_S)
                found = sum(1 for _ in rtu_answers(heard, unit, block))
        asked.sent -= found
        if asked.missed and asked.sent <= 0:
            self._unanswered.habits.was_late(unit, asyncio.get_running_loop().time() - asked.since_s)
        self._unanswered.settle(unit, block)
        self._note(heard, unit, block)
        return asked.sent <= 0

    def _missed(self, unit: int, block: Block, like: Block, heard: bytearray) -> None:
        asked = self._unanswered.asked(unit, block)
        asked.missed = True
        if is_damaged(heard, block):
            self._came(unit, block)
        else:
            self._patience.missed(unit, like)
        self._note(heard, unit, block)

    def _came(self, unit: int, block: Block) -> None:
        """An answer has come, though not a good one: it is not due any more."""
        asked = self._unanswered.asked(unit, block)
        asked.sent -= 1
        if not asked.sent:
            self._unanswered.settle(unit, block)

    def _foreign_refusal(self, heard: bytes | bytearray, unit: int) -> bytes | None:
        """The unit's refusal of another function than it was asked for, unless that may be a late answer."""
        message = foreign_refusal(heard, unit)
        if message is None or any(
            u == unit and other.function == message[0] & 0x7F for u, other in self._unanswered.due
        ):
            return None
        return message

    def _note(self, heard: bytes | bytearray, unit: int = 0, block: Block | None = None) -> None:
        """Bytes that were heard, beside the answer to this block or while nothing was asked."""
        if not heard:
            return
        is_only_answer = block is not None and len(heard) == rtu_length(block)
        if is_only_answer:
            self._strangers.forget()
        else:
            now_s = asyncio.get_running_loop().time()
            self._strangers.hear(heard, now_s)
            self._repeats.note(heard, now_s, (*self._unanswered.due, *([] if block is None else [(unit, block)])))
            if not _is_frame_of(heard, unit):  # its own answer, though not to what it was asked
                self._strangers.note(heard, now_s)
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
            self._note(heard)
            self._owing_until = None

    def _nothing_valid(
        self, device: str, unit: int, block: Block, heard: bytes | bytearray, waited_s: float, late: Collection[int]
    ) -> NoAnswer | BadAnswer:
        """late: the units whose answers to earlier requests are among what was heard"""
        is_late = self._unanswered.was_heard(unit) or unit in late
        if not heard or unit in late:
            return self._silence(device, unit, waited_s, heard=is_late)
        if (other := heard[0]) != unit and other not in late and find_rtu_answer(heard, other, block):
            return BadAnswer(
                f"unit {other} answered instead of unit {unit}",
                heard=is_late,
                bus=self._name,
                device=device,
                hint=f"if it is alone on the line, ask it as unit {other}; otherwise another master asks it",
            )
        if _is_frame_of(heard, unit):
            return BadAnswer(
                f"the answer does not fit function {block.function}, count {block.count}: {heard[:16].hex(' ')}",
                bus=self._name,
                device=device,
                hint=DOES_NOT_FIT,
            )
        return BadAnswer(
            f"{len(heard)} bytes received, but no valid answer of unit {unit}: {heard[:16].hex(' ')}",
            heard=is_late or plausibly_of(heard, unit, block),
            bus=self._name,
            device=device,
            hint="two units with one id, wrong baud or parity, missing termination, or noise",
        )


def _is_frame_of(heard: bytes | bytearray, unit: int) -> bool:
    """Whether this is one whole frame of that unit, and nothing else."""
    return heard[0] == unit and is_rtu_frame(heard)


class ModbusRtuBus(RtuFramedBus):
    """Units on a serial line of this computer, or on one of a device server."""

    kind = ModbusRtuSettings.bus_kind

    def __init__(self, name: str, settings: ModbusRtuSettings, tap: Tap | None = None) -> None:
        gap_s = 3.5 * 11 / settings.baud
        super().__init__(
            name,
            serial_stream(name, settings, tap),
            settings.timeout_s,
            local_echo=settings.local_echo,
            gap_s=gap_s,
            pause_s=max(pause_s(settings), 4 * gap_s),
        )
        self.reopens = settings.port.startswith("socket:")  # negotiating RFC 2217 again takes longer than a period


class ModbusRtuTcpBus(RtuFramedBus):
    """Units on the serial line of a device server, which passes on the bytes of a TCP connection."""

    kind = ModbusRtuTcpSettings.bus_kind
    carries = ModbusRtuTcpSettings.carries
    reopens = True

    def __init__(self, name: str, settings: ModbusRtuTcpSettings, tap: Tap | None = None) -> None:
        super().__init__(
            name,
            TcpStream(name, settings.host, settings.port, tap),
            settings.timeout_s,
            local_echo=settings.local_echo,
            gap_s=_SERVER_GAP_S,
            pause_s=SERVER_PAUSE_S,
        )
