"""CAN devices that send without being asked, described by a DBC file.

cantools reads it; as it takes long to load, it is imported where there is such a file.
"""

from collections.abc import Collection
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from drivers.base import Quality
from drivers.bounded_file import bytes_of
from drivers.can.dbc_file import MOST_DBC_BYTES, DbcFile, DbcMessage
from drivers.can.multiplex import alone, overlapping, pages_of
from drivers.can.wanted import WantedFrame
from drivers.error_words import in_words
from drivers.faults import CodeRule, Fault, NumberRule, RangeRule, RawNumber
from drivers.problems import suggestion
from drivers.profile import DeviceProfile
from drivers.readings import total
from drivers.section import OTHER_ENCODING, FilePath, Section, wrong
from drivers.text import Text

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
            text = Text("can_frame_short", count=len(data), name=self.signal.name, message=self.message.name)
            return Fault(Quality.COMM_FAULT, text)
        if not isinstance(decoded, dict):
            return Fault(Quality.COMM_FAULT, Text("can_container", message=self.message.name))
        raw: Any = decoded[self.signal.name]
        if (fault := self.raw.fault(self.rules, raw)) is not None:
            return fault
        value = float(total(raw * self.signal.conversion.scale, self.signal.conversion.offset))
        if not isfinite(value):
            return Fault(Quality.SENSOR_FAULT, Text("sends_no_number"))
        low, high = self.signal.minimum, self.signal.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            return Fault(Quality.OUT_OF_RANGE, Text("can_beyond", value=value, low=low, high=high))
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
        messages = {message.name: message for message in self._database(file, wanted.values()).messages}
        for i, entry in enumerate(self.entries):
            if entry.message not in messages:
                what = Text("dbc_same_identifier", message=entry.message)
                raise wrong(what, "signal", i, "message")
        self._signals = tuple(
            _signal(entry, messages[entry.message], "signal", i) for i, entry in enumerate(self.entries)
        )
        return self

    def _file(self) -> DbcFile:
        try:
            file = DbcFile(bytes_of(self.dbc, MOST_DBC_BYTES).decode(OTHER_ENCODING, "replace"))
        except OSError as error:
            raise wrong(Text("path_unreadable", path=str(self.dbc), why=in_words(error)), "dbc") from error
        if not file.messages:
            raise wrong(Text("dbc_empty", path=str(self.dbc)), "dbc")
        return file

    def _database(self, file: DbcFile, wanted: Collection[DbcMessage]) -> "Database":
        from cantools.database import load_string
        from cantools.database.can import Database
        from cantools.database.errors import Error as DbcError

        try:
            # Not strict: what is wrong with signals that no channel needs does not matter.
            database = load_string(file.only(wanted), database_format="dbc", strict=False)
        except (DbcError, ValueError) as error:
            raise wrong(Text("path_unreadable", path=str(self.dbc), why=in_words(error)), "dbc") from error
        if not isinstance(database, Database):
            raise wrong(Text("dbc_empty", path=str(self.dbc)), "dbc")
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
        raise wrong(
            Text("dbc_no_message", message=entry.message, advice=suggestion(entry.message, file.messages)),
            *at,
            "message",
        )
    if message.name in file.twice:
        raise wrong(Text("dbc_message_twice", message=message.name), *at, "message")
    stated = message.signals.get(entry.name)
    if stated is None:
        raise wrong(
            Text("dbc_no_signal", signal=entry.name, advice=suggestion(entry.name, message.signals)), *at, "name"
        )
    if len(stated) > 1:
        what = Text("dbc_signal_twice", message=message.name, count=len(stated), signal=entry.name)
        raise wrong(what, *at, "name")
    if not message.whole(entry.name):
        what = Text("dbc_signal_long", signal=entry.name, message=message.name, bytes=message.bytes)
        raise wrong(what, *at, "name")
    return message


def _signal(entry: SignalEntry, message: "Message", *at: str | int) -> DbcSignal:
    signals = {signal.name: signal for signal in message.signals}
    signal = signals.get(entry.name)
    if signal is None:
        what = Text("dbc_signal_lost", signal=entry.name, message=message.name, identifier=message.frame_id)
        raise wrong(what, *at, "name")
    if other := overlapping(signal, signals):
        raise wrong(Text("dbc_shared_bits", signal=signal.name, other=other, message=message.name), *at, "name")
    raw = RawNumber(signal.name, signal.length, signed=signal.is_signed, real=signal.is_float)
    for number, rule in enumerate(entry.invalid):
        raw.check(rule, *at, "invalid", number)
    frame = WantedFrame(message.frame_id, message.is_extended_frame, pages_of(signal, signals))
    return DbcSignal(alone(message, signal), signal, frame, raw, entry.invalid)
