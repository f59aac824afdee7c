"""Modbus RTU on a serial line, and over TCP through a device server: frames with a checksum and without a number.

Source: MODBUS over serial line V1.02.
"""

import asyncio
from contextlib import suppress

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.byte_stream import ByteStream, TcpStream
from drivers.modbus.bus import DOES_NOT_FIT, ModbusBus
from drivers.modbus.frames import (
    find_rtu_answer,
    foreign_refusal,
    is_damaged,
    is_damaged_of,
    is_rtu_frame,
    plausibly_of,
    rtu_length,
    rtu_messages,
    rtu_request,
)
from drivers.modbus.numbers import Block
from drivers.modbus.settings import AskedSettings, ModbusRtuSettings, ModbusRtuTcpSettings
from drivers.modbus.strangers import Strangers
from drivers.patience import Patience
from drivers.requests import Came
from drivers.serial_server import SERVER_PAUSE_S, pause_s, serial_stream
from drivers.tap import Tap
from drivers.text import Text

_GROWTH = 2.0
"""Factor of the wait, each time a question is repeated. A wait that was too short costs one more request and no value,
as the late answer is as good."""
_MOST_CROSSED = 3
"""How often an answer that may be another master's is asked for again."""
_MOST_SEPARATORS = 2
"""Nobody may know which request a unit has refused; then one of another function follows."""
_FOLLOWS_S = 0.05
"""How soon the answer to a repeated request follows the answer to the first one."""
_SERVER_GAP_S = 3.5 * 11 / 9600
"""Between frames behind a device server, whose line's speed is not known here; the network adds its own delay."""


class RtuFramedBus(ModbusBus):
    """Units on one line, or one connection. `Requests` says how late answers are told from the next ones.

    Parameters
    ----------
    local_echo: whether each request is received before its answer; None: not known yet
    gap_s: silence between an answer and the next request
    pause_s: after a pause of this length, what was being sent has ended
    """

    units = ModbusRtuSettings.units
    has_checksum = True

    def __init__(
        self,
        name: str,
        settings: AskedSettings,
        stream: ByteStream,
        *,
        local_echo: bool | None,
        gap_s: float,
        pause_s: float,
    ) -> None:
        super().__init__(name, settings, stream, Patience(settings.timeout_s, _GROWTH))
        self._gap_s, self._pause_s, self._echo = gap_s, pause_s, local_echo
        self._quiet_since = 0.0
        self._owing_until: float | None = None
        """Until when the answer to a cancelled request may come."""
        self._strangers = Strangers()
        self._separates = False
        """Whether what is asked is to settle earlier requests."""
        self._sorted_to = 0
        """So much of what was heard has been given to its requests."""
        self._before = b""
        """What was heard last before the present request."""
        self._crossed = False
        """Whether another master's request was heard just before the latest answer, which may be the answer to that."""

    def other_master(self) -> str:
        """What shows that another master is on the line, in words; empty if nothing does."""
        return self._strangers.evidence(asyncio.get_running_loop().time())

    def _opened(self) -> None:
        self._owing_until = None

    async def _listen(self) -> None:
        await self._wait_for_owed_answer()
        self._note(bytearray(self._stream.discard()), 0)

    async def _asked(self, device: str, unit: int, block: Block) -> Came:
        requests = self._requests
        separator = requests.separator(unit, block)
        if separator is None and self._echo is None and find_rtu_answer(rtu_request(unit, block), unit, block):
            # The request would be its own answer: learn from another one whether requests come back.
            separator = requests.another(unit, block)
        for _ in range(_MOST_SEPARATORS):
            if separator is None:
                break
            self._separates = requests.separator(unit, block) is not None
            try:
                await self._request(device, unit, separator, block)
            finally:
                self._separates = False
            separator = requests.separator(unit, block)
        if separator is not None:
            raise self._silence(device, unit, self._timeout_s, heard=True)
        came = await self._request(device, unit, block, block)
        for _ in range(_MOST_CROSSED):
            if not self._crossed:
                break
            came = await self._once_more(device, unit, block)
        if self._crossed:
            raise BadAnswer(
                Text("modbus_other_master", unit=unit),
                bus=self._name,
                device=device,
                hint=Text("modbus_one_master"),
            )
        now_s = asyncio.get_running_loop().time()
        if requests.is_doubtful(unit, block, came.message, now_s):
            requests.doubt(unit, block, came.sent_s)
            doubtful, came = came, await self._once_more(device, unit, block)
            requests.confirmed(unit, block, came.message, now_s)
            if doubtful.message != came.message:
                self._rests.copied(unit, requests.copy_s(unit, doubtful.message, now_s) or 0.0, now_s)
        return came

    async def _once_more(self, device: str, unit: int, block: Block) -> Came:
        """Ask for something else, so that nothing older can follow, and then again."""
        await self._request(device, unit, self._requests.another(unit, block), block)
        return await self._request(device, unit, block, block)

    async def _quieten(self, unit: int, block: Block) -> None:
        if (gap_s := self._quiet_since + self._gap_s - asyncio.get_running_loop().time()) > 0:
            await asyncio.sleep(gap_s)
        self._before = await self._let_others_be_answered(unit, block)
        self._strangers.asked(unit, block)

    def _send(self, unit: int, block: Block) -> None:
        now_s = asyncio.get_running_loop().time()
        self._owing_until = now_s + self._timeout_s
        self._stream.write(rtu_request(unit, block))
        self._requests.sent(unit, block, now_s)

    def _wait_s(self, unit: int, like: Block) -> float:
        return self._patience.wait_s(unit, like, loses=self._requests.loses(unit))

    def _sort(self, heard: bytearray, start: int, *, has_just_come: bool = True) -> int:
        now_s, requests = asyncio.get_running_loop().time(), self._requests
        for end, unit, message in rtu_messages(heard, start, requests.due()):
            requests.came(unit, message, now_s)
            start = end
        if start < len(heard):
            for end, unit, message in rtu_messages(heard, start, requests.due(recent=True)):
                if (after_s := requests.copy_s(unit, message, now_s)) is not None:
                    self._rests.copied(unit, after_s if has_just_come else 0.0, now_s)
                    start = end
        return start

    async def _hear(
        self, heard: bytearray, unit: int, block: Block, like: Block, latest_s: float, wait_s: float
    ) -> Came:
        loop, requests = asyncio.get_running_loop(), self._requests
        until, request = min(latest_s, loop.time() + wait_s), rtu_request(unit, block)
        self._sorted_to = len(heard)
        try:
            while (came := requests.took(unit, block)) is None:
                if self._separates and not (requests.expects(unit, block) or requests.separator(unit, like)):
                    return Came(unit, b"", loop.time())
                heard += await self._stream.read(until - loop.time())
                self._skip_echo(heard, request, unit, block)
                self._sorted_to = self._sort(heard, min(self._sorted_to, len(heard)))
                until = min(latest_s, loop.time() + self._longer_s(heard[self._sorted_to :], unit, block, wait_s))
        except asyncio.CancelledError:
            requests.withdraw(unit)
            raise
        finally:
            self._quiet_since = loop.time()
        if self._echo is None:
            self._echo = False
        return came

    def _longer_s(self, rest: bytearray, unit: int, block: Block, wait_s: float) -> float:
        """Lets an answer that has begun finish; one that is complete and not valid has ended."""
        if not rest:
            return wait_s
        refused = self._foreign_refusal(rest, unit)
        new = refused is not None and not self._rests.sends_copies(unit, asyncio.get_running_loop().time())
        return self._pause_s if new or is_damaged(rest, block) else wait_s

    async def _answered(self, unit: int, block: Block, came: Came, heard: bytearray) -> None:
        frame = bytes((unit,)) + came.message
        await self._look_for_others(unit, block, self._before + heard[: max(0, heard.find(frame))], heard)
        with suppress(TimeoutError, ConnectError):  # an answer counts although the server hangs up after it
            while self._requests.open(unit, block):  # the answers to the others for it follow at once
                start = len(heard)
                heard += await self._stream.read(_FOLLOWS_S)
                self._sort(heard, start)
        self._requests.was_heard(unit)
        self._note_others(heard, unit, block)
        self._owing_until = None

    async def _missed(
        self, device: str, unit: int, block: Block, like: Block, heard: bytearray, waited_s: float
    ) -> bytes:
        self._owing_until = None
        if block != like and self._separates and self._requests.separator(unit, like) != block:
            return b""  # what was asked before is settled, or another one is needed
        if (message := self._foreign_refusal(heard[self._sorted_to :], unit)) is not None:
            self._requests.spoilt(unit, block)
            return message
        if is_damaged_of(heard[self._sorted_to :], unit, block):
            self._requests.spoilt(unit, block)
        else:
            self._patience.missed(unit, like)
        self._note_others(heard, unit, block)
        raise self._nothing_valid(device, unit, block, heard, waited_s)

    async def _let_others_be_answered(self, unit: int, block: Block) -> bytes:
        """Wait for the answer to another master's request that looks like the one to this; returns the end of what was
        heard, which may be the beginning of such a request."""
        self._note(bytearray(self._stream.discard()), 0)
        if self._strangers.waits(unit, block, asyncio.get_running_loop().time() - self._timeout_s):
            heard = bytearray()
            await self._let_pass(heard, min(self._timeout_s, self.left_s))
            self._note(heard, 0)
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

    def _skip_echo(self, heard: bytearray, request: bytes, unit: int, block: Block) -> None:
        """Take the request itself from what was heard, unless it may be the answer of a line without echo."""
        if heard.startswith(request) and (self._echo or not find_rtu_answer(request, unit, block)):
            self._echo = True
            del heard[: len(request)]

    def _foreign_refusal(self, heard: bytes | bytearray, unit: int) -> bytes | None:
        """The unit's refusal of another function than it was asked for, unless that may be a late answer."""
        message = foreign_refusal(heard, unit)
        if message is None or self._requests.may_be_refused(unit, message):
            return None
        return message

    def _note(self, heard: bytearray, start: int) -> None:
        """What was heard while nothing was asked."""
        if heard:
            self._sort(heard, start, has_just_come=False)
            self._note_others(heard)

    def _note_others(self, heard: bytes | bytearray, unit: int = 0, block: Block | None = None) -> None:
        """Look for another master in what was heard, beside the answer to this block or while nothing was asked."""
        if not heard:
            return
        if block is not None and len(heard) == rtu_length(block):
            self._strangers.forget()
            return
        now_s = asyncio.get_running_loop().time()
        self._strangers.hear(heard, now_s)
        if not _is_frame_of(heard, unit):  # its own answer, though not to what it was asked
            self._strangers.note(heard, now_s)

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
            self._note(heard, 0)
            self._owing_until = None

    def _nothing_valid(
        self, device: str, unit: int, block: Block, heard: bytes | bytearray, waited_s: float
    ) -> NoAnswer | BadAnswer:
        late = self._requests.late
        is_late, rest = self._requests.was_heard(unit), heard[self._sorted_to :]
        if not rest or unit in late:
            return self._silence(device, unit, waited_s, heard=is_late)
        if (other := heard[0]) != unit and other not in late and find_rtu_answer(heard, other, block):
            return BadAnswer(
                Text("modbus_other_unit", other=other, unit=unit),
                heard=is_late,
                bus=self._name,
                device=device,
                hint=Text("modbus_alone", other=other),
            )
        if _is_frame_of(heard, unit):
            return BadAnswer(
                Text("modbus_does_not_fit", function=block.function, count=block.count, bytes=heard[:16].hex(" ")),
                bus=self._name,
                device=device,
                hint=DOES_NOT_FIT,
            )
        return BadAnswer(
            Text("modbus_no_valid", count=len(heard), unit=unit, bytes=heard[:16].hex(" ")),
            heard=is_late or plausibly_of(heard, unit, block),
            bus=self._name,
            device=device,
            hint=Text("modbus_disturbed_line"),
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
            settings,
            serial_stream(name, settings, tap),
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
            settings,
            TcpStream(name, settings.host, settings.port, tap),
            local_echo=settings.local_echo,
            gap_s=_SERVER_GAP_S,
            pause_s=SERVER_PAUSE_S,
        )
