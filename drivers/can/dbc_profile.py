"""CAN devices that send without being asked, described by a DBC file.

cantools reads it; as it takes long to load, it is imported where there is such a file.
"""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from drivers.base import Quality
from drivers.can.dbc_file import DbcFile, DbcMessage
from drivers.can.multiplex import alone, overlapping, pages_of
from drivers.can.wanted import WantedFrame
from drivers.error_words import in_words
from drivers.faults import CodeRule, Fault, NumberRule, RangeRule, RawNumber
from drivers.problems import suggestion
from drivers.profile import DeviceProfile
from drivers.readings import total
from drivers.section import OTHER_ENCODING, FilePath, Section, wrong

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One channel: a signal of a message, and the raw numbers that mean a fault."""

    message: "Message"
    signal: "Signal"
    frame: WantedFrame
    """The frames that hold it."""
    raw: RawNumber
    rules: tuple[CodeRule | RangeRule, ...]
    """Rules for invalid values, the most specific first."""

    def decode(self, data: bytes) -> float | Fault:
        """The scaled value, or a fault: frame too short, raw number that means a fault, or value out of the DBC's
        range."""
        from cantools.database.errors import Error as DbcError

        try:
            decoded = self.message.decode(data, decode_choices=False, scaling=False)
        except (DbcError, ValueError):
            text = f"frame of {len(data)} bytes does not contain {self.signal.name} of message {self.message.name}"
            return Fault(Quality.COMM_FAULT, text)
        if not isinstance(decoded, dict):
            return Fault(Quality.COMM_FAULT, f"message {self.message.name} holds other messages")
        raw: Any = decoded[self.signal.name]
        if (fault := self.raw.fault(self.rules, raw)) is not None:
            return fault
        value = float(total(raw * self.signal.conversion.scale, self.signal.conversion.offset))
        if not isfinite(value):
            return Fault(Quality.SENSOR_FAULT, "the device sends no number")
        low, high = self.signal.minimum, self.signal.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            return Fault(Quality.OUT_OF_RANGE, f"{value:g} is beyond the range of the DBC file, {low} to {high}")
        return value


class SignalEntry(Section):
    """Which signal a channel reads."""

    message: str
    """Name of its message in the DBC file."""
    name: str
    """Name of the signal in the DBC file."""
    invalid: tuple[NumberRule, ...] = ()
    """Raw numbers that mean a fault, the most specific first."""


class CanDbcProfile(DeviceProfile):
    """A device with signals that a DBC file names."""

    buses: ClassVar[tuple[str, ...]] = ("can",)

    protocol: Literal["can_dbc"]
    """`can_dbc`."""
    dbc: FilePath
    """The DBC file; a relative path starts at the profile's folder."""
    entries: tuple[SignalEntry, ...] = Field(alias="signal", min_length=1)
    _signals: tuple[DbcSignal, ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _found(self) -> Self:
        file = self._file()
        stated = [_stated(entry, file, "signal", i) for i, entry in enumerate(self.entries)]
        wanted = {message.name: message for message in stated}
        messages = {message.name: message for message in self._database(file.only(wanted.values())).messages}
        for i, entry in enumerate(self.entries):
            if entry.message not in messages:
                what = f"message {entry.message} has the identifier of another one that a channel uses"
                raise wrong(f"{what}; give it its own in the DBC file", "signal", i, "message")
        self._signals = tuple(
            _signal(entry, messages[entry.message], "signal", i) for i, entry in enumerate(self.entries)
        )
        return self

    def _file(self) -> DbcFile:
        try:
            file = DbcFile(self.dbc.read_text(OTHER_ENCODING, "replace"))
        except OSError as error:
            raise wrong(f"{self.dbc} cannot be read: {in_words(error)}", "dbc") from error
        if not file.messages:
            raise wrong(f"{self.dbc} describes no CAN messages", "dbc")
        return file

    def _database(self, text: str) -> "Database":
        from cantools.database import load_string
        from cantools.database.can import Database
        from cantools.database.errors import Error as DbcError

        try:
            # Not strict: what is wrong with signals that no channel needs does not matter.
            database = load_string(text, database_format="dbc", strict=False)
        except (DbcError, ValueError) as error:
            raise wrong(f"{self.dbc} cannot be read: {in_words(error)}", "dbc") from error
        if not isinstance(database, Database):
            raise wrong(f"{self.dbc} describes no CAN messages", "dbc")
        return database

    @property
    def other_file(self) -> tuple[str, Path]:
        """The DBC file."""
        return "dbc", self.dbc

    @property
    def signals(self) -> tuple[DbcSignal, ...]:
        """The signal of each channel."""
        return self._signals

    @property
    def channels(self) -> int:
        return len(self.entries)


def _stated(entry: SignalEntry, file: DbcFile, *at: str | int) -> DbcMessage:
    """The message of the entry. Raises an error if it or the signal is not stated exactly once, or does not fit."""
    message = file.messages.get(entry.message)
    if message is None:
        raise wrong(f"unknown message {entry.message!r}; {suggestion(entry.message, file.messages)}", *at, "message")
    if message.name in file.twice:
        raise wrong(f"the DBC file has several messages {message.name}; rename all but one", *at, "message")
    stated = message.signals.get(entry.name)
    if stated is None:
        raise wrong(f"unknown signal {entry.name!r}; {suggestion(entry.name, message.signals)}", *at, "name")
    if len(stated) > 1:
        what = f"message {message.name} has {len(stated)} signals {entry.name}, such as on several pages"
        raise wrong(f"{what}; rename all but one in the DBC file", *at, "name")
    if not message.whole(entry.name):
        what = f"by the DBC file {entry.name} does not fit into message {message.name} of {message.bytes} bytes"
        raise wrong(f"{what}; a number has at most 64 bits", *at, "name")
    return message


def _signal(entry: SignalEntry, message: "Message", *at: str | int) -> DbcSignal:
    signals = {signal.name: signal for signal in message.signals}
    signal = signals.get(entry.name)
    if signal is None:
        what = f"the DBC file states {entry.name}, but not as a signal of message {message.name} that can be read"
        raise wrong(f"{what}; is identifier {message.frame_id} that of another message too?", *at, "name")
    if other := overlapping(signal, signals):
        raise wrong(f"by the DBC file {signal.name} and {other} share bits of message {message.name}", *at, "name")
    raw = RawNumber(signal.name, signal.length, signed=signal.is_signed, real=signal.is_float)
    for number, rule in enumerate(entry.invalid):
        raw.check(rule, *at, "invalid", number)
    frame = WantedFrame(message.frame_id, message.is_extended_frame, pages_of(signal, signals))
    return DbcSignal(alone(message, signal), signal, frame, raw, entry.invalid)
