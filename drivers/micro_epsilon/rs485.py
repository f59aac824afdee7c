"""Micro-Epsilon displacement sensors on RS-485.

Request `10 DA SA 4C FCS 16`; answer `68 LE LE 68 DA SA 08 data FCS 16`. LE counts DA to the last data byte; FCS is
their sum modulo 256. Answers are not numbered: `MeRs485Bus.measure` says how late ones are rejected.
"""

import asyncio
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from drivers.base import BadAnswer, Clock, NoAnswer, Quality, Reading
from drivers.byte_stream import StreamBus
from drivers.faults import Fault
from drivers.micro_epsilon.profile import MeRs485Profile
from drivers.micro_epsilon.scaling import Renewal, counted_um, distance_um
from drivers.micro_epsilon.settings import DisplacementOptions, MeRs485Settings
from drivers.patience import Patience
from drivers.readings import ReadingMaker
from drivers.serial_server import pause_s, serial_stream
from drivers.tap import Tap
from drivers.text import Text

_MASTER = 0x01
_MEASURE = 0x4C
_RESPONSE = 0x08
_END = 0x16
_SHORTEST_LE = 3
_MOST_SENT = 2
"""How often a silent sensor is sent one question; then only its late answer is waited for."""
_FLOATS = struct.Struct("<ff")
_COUNTED = struct.Struct("<HBx")


class MeRs485Bus(StreamBus):
    """Sensors on one serial line."""

    kind = MeRs485Settings.bus_kind
    units = MeRs485Settings.units

    def __init__(self, name: str, settings: MeRs485Settings, tap: Tap | None = None) -> None:
        super().__init__(name, serial_stream(name, settings, tap), settings.timeout_s)
        self._patience = Patience(settings.timeout_s)
        self._pause_s = pause_s(settings)
        self._owed: dict[int, int] = {}
        """How many answers each sensor still owes, by address."""
        self._length: dict[int, int] = {}
        """How many bytes each sensor's last answer had, by address."""

    async def measure(self, device: str, address: int, *, again: bool = False) -> bytes:
        """The data of one answer. Raises NoAnswer, BadAnswer or ConnectError.

        After a timeout or a cancelled wait an answer is still due, and it would look like the sensor's next one. The
        next request to that sensor therefore waits until all answers due have arrived, or for the whole timeout if one
        was lost, and takes the last one. Answers of other sensors carry other addresses, so those need not wait.

        again: this repeats the last question, so that an answer to that one is as good; it is not sent a third time
        """
        async with self._lock:
            self._count(self._stream.discard())
            owed = self._owed.get(address, 0)
            if not again or owed < _MOST_SENT:
                self._stream.write(request_frame(address))
                self._owed[address] = owed + 1
            heard = bytearray()
            loop = asyncio.get_running_loop()
            sent = answered = loop.time()
            wait_s = self._timeout_s if owed else self._patience.wait_s(address, _MEASURE)
            until = sent + wait_s
            answers: list[bytes] = []
            try:
                while len(answers) <= (0 if again else owed):
                    heard += await self._stream.read(until - loop.time())
                    if len(found := find_answers(heard, address)) > len(answers):
                        answers, answered = found, loop.time()
                    # Lets an answer that has begun finish; one that is complete and not valid is damaged.
                    damaged = not answers and len(heard) == self._length.get(address)
                    until = min(sent + self._timeout_s, loop.time() + (self._pause_s if damaged else wait_s))
            except TimeoutError:
                if not answers:
                    if len(heard) == self._length.get(address):  # damaged: this one is no longer due
                        self._owed[address] -= 1
                    else:
                        self._patience.missed(address)
                    raise self._nothing_valid(device, address, heard, wait_s) from None
            finally:
                self._count(heard)
            if not again:
                self._owed[address] = 0
                self._patience.answered(address, _MEASURE, answered - sent)
            self._length[address] = 9 + len(answers[-1])
            return answers[-1]

    def _count(self, heard: bytes | bytearray) -> None:
        """Subtract the answers that have arrived from those that are due."""
        for address, owed in self._owed.items():
            if owed:
                self._owed[address] = max(0, owed - len(find_answers(heard, address)))

    def _nothing_valid(
        self, device: str, address: int, heard: bytes | bytearray, waited_s: float
    ) -> NoAnswer | BadAnswer:
        if not heard:
            return NoAnswer(
                Text("me_sensor_silent", address=address, waited_s=waited_s),
                hurried=waited_s < self._timeout_s,
                bus=self._name,
                device=device,
                hint=Text("me_check"),
            )
        return BadAnswer(
            Text("me_no_valid", count=len(heard), address=address, bytes=heard[:16].hex(" ")),
            bus=self._name,
            device=device,
            hint=Text("me_disturbed"),
        )


@dataclass(frozen=True, slots=True)
class Counted:
    """What a `counted` payload holds."""

    counter: int
    counts: tuple[int, ...]
    """The newest is the last."""


class MeRs485Device:
    """One sensor with one channel."""

    def __init__(
        self,
        device: str,
        bus: MeRs485Bus,
        profile: MeRs485Profile,
        address: int,
        channels: Mapping[str, int],
        options: DisplacementOptions,
        clock: Clock,
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._address = bus, profile, address
        (self._channel,) = channels
        self._options, self._renewal = options, Renewal()
        self._maker = ReadingMaker(dict.fromkeys(channels, profile.unit), clock)

    async def connect(self) -> None:
        """Check that the sensor answers in the expected form. Raises the bus's errors."""
        self._decoded(await self._bus.measure(self.device, self._address))

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        """One reading, in µm."""
        value = self._decoded(await self._bus.measure(self.device, self._address, again=again))
        return self._maker.make({self._channel: self._distance(value)})

    async def close(self) -> None:
        """Nothing to close: the bus owns the port."""

    def _decoded(self, data: bytes) -> float | Counted:
        try:
            return decode_float(data) if self._profile.value.payload == "float" else decode_counted(data)
        except ValueError as error:
            raise BadAnswer(str(error), bus=self._bus.name, device=self.device, hint=Text("me_payload")) from error

    def _distance(self, value: float | Counted) -> float | Fault:
        if isinstance(value, Counted):
            same = self._renewal.fault(value.counter, value.counts)
            return same or counted_um(value.counts[-1], self._profile.value, self._options)
        if not isfinite(value):
            return Fault(Quality.SENSOR_FAULT, Text("me_no_number"))
        return distance_um(value, self._profile.value, self._options)


def decode_float(data: bytes) -> float:
    """The unscaled value of the `float` payload. Raises ValueError for any other length."""
    if len(data) != _FLOATS.size:
        raise ValueError(f"{len(data)} data bytes, not {_FLOATS.size}")
    return float(_FLOATS.unpack(data)[0])


def decode_counted(data: bytes) -> Counted:
    """Counter and values of the `counted` payload. Raises ValueError when the number and the length disagree."""
    if len(data) < _COUNTED.size + 4:
        raise ValueError(f"{len(data)} data bytes, at least {_COUNTED.size + 4} expected")
    counter, number = _COUNTED.unpack_from(data)
    if len(data) != _COUNTED.size + 4 * number:
        raise ValueError(f"{len(data)} data bytes do not hold {number} values")
    return Counted(counter, struct.unpack_from(f"<{number}i", data, _COUNTED.size))


def request_frame(address: int) -> bytes:
    """The request for one measurement."""
    body = bytes((address, _MASTER, _MEASURE))
    return b"\x10" + body + bytes((sum(body) % 256, _END))


def find_answers(heard: bytes | bytearray, address: int) -> list[bytes]:
    """The data of every valid answer of this sensor in `heard`, in order; noise and broken frames are skipped."""
    answers: list[bytes] = []
    start = 0
    while (start := heard.find(b"\x68", start)) >= 0:
        data = _answer_at(heard, start, address)
        if data is None:
            start += 1
        else:
            answers.append(data)
            start += 9 + len(data)
    return answers


def _answer_at(heard: bytes | bytearray, start: int, address: int) -> bytes | None:
    if len(heard) < start + 4:
        return None
    length = heard[start + 1]
    end = start + 4 + length + 2
    if heard[start + 2] != length or heard[start + 3] != 0x68 or length < _SHORTEST_LE or len(heard) < end:
        return None
    body = bytes(heard[start + 4 : end - 2])
    if heard[end - 1] != _END or sum(body) % 256 != heard[end - 2]:
        return None
    return body[3:] if body[:3] == bytes((_MASTER, address, _RESPONSE)) else None
