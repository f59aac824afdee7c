"""CAN devices that send without being asked, described by a DBC file.

cantools reads it; as it takes long to load, it is imported where there is such a file.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from drivers.base import Quality
from drivers.can.multiplex import alone, pages_of
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
            text = f"frame of {len(data)} bytes does not contain message {self.message.name}"
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
        messages = {message.name: message for message in self._database().messages}
        self._signals = tuple(_signal(entry, messages, "signal", i) for i, entry in enumerate(self.entries))
        return self

    def _database(self) -> "Database":
        from cantools.database import load_file
        from cantools.database.can import Database
        from cantools.database.errors import Error as DbcError

        try:
            database = load_file(self.dbc, database_format="dbc", encoding=OTHER_ENCODING)
        except (OSError, DbcError, ValueError) as error:
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


def _signal(entry: SignalEntry, messages: "Mapping[str, Message]", *at: str | int) -> DbcSignal:
    message = messages.get(entry.message)
    if message is None:
        raise wrong(f"unknown message {entry.message!r}; {suggestion(entry.message, messages)}", *at, "message")
    if message.is_container:
        raise wrong(f"{message.name} is a container, which is not supported", *at, "message")
    signals = {signal.name: signal for signal in message.signals}
    signal = signals.get(entry.name)
    if signal is None:
        raise wrong(f"unknown signal {entry.name!r}; {suggestion(entry.name, signals)}", *at, "name")
    raw = RawNumber(signal.name, signal.length, signed=signal.is_signed, real=signal.is_float)
    for number, rule in enumerate(entry.invalid):
        raw.check(rule, *at, "invalid", number)
    frame = WantedFrame(message.frame_id, message.is_extended_frame, pages_of(signal, signals))
    holder = alone(message, signal) if message.is_multiplexed() else message
    return DbcSignal(holder, signal, frame, raw, entry.invalid)
