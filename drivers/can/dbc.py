"""Plain CAN devices that send by themselves, described by a DBC file (read by cantools)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error as DbcError

from drivers.base import Clock, Quality, Reading
from drivers.can.bus import CanBus, FrameId
from drivers.faults import CodeRule, Fault, RangeRule, code_rule, range_rule
from drivers.readings import ReadingMaker
from drivers.toml_table import Table

DBC_ENCODING = "cp1252"


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One channel: a signal of a message, and the raw numbers that mean a fault."""

    message: Message
    signal: Signal
    rules: tuple[CodeRule | RangeRule, ...]
    """The most telling first."""

    @property
    def frame(self) -> FrameId:
        return self.message.frame_id, self.message.is_extended_frame

    @property
    def bits(self) -> int:
        """Every bit of the raw number."""
        return _bits(self.signal)

    def decode(self, data: bytes) -> float | Fault:
        """The scaled value; a fault for a frame too short, a stated raw number, or a value beyond the DBC's range."""
        try:
            decoded = self.message.decode(data, decode_choices=False, scaling=False)
        except (DbcError, ValueError):
            text = f"frame of {len(data)} bytes does not hold message {self.message.name}"
            return Fault(Quality.COMM_FAULT, text)
        if not isinstance(decoded, dict):
            return Fault(Quality.COMM_FAULT, f"message {self.message.name} holds other messages")
        raw: Any = decoded[self.signal.name]
        for rule in self.rules:
            if rule.matches(raw & self.bits if isinstance(rule, CodeRule) else raw):
                return rule.fault
        value = float(self.signal.conversion.raw_to_scaled(raw, decode_choices=False))  # type: ignore[arg-type]
        if not isfinite(value):
            return Fault(Quality.SENSOR_FAULT, "the device sends no number")
        low, high = self.signal.minimum, self.signal.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            return Fault(Quality.OUT_OF_RANGE, f"{value:g} is beyond the range of the DBC file, {low} to {high}")
        return value


@dataclass(frozen=True, slots=True)
class CanDbcProfile:
    """A device whose signals a DBC file names."""

    name: str
    title: str
    unit: str
    confirm: tuple[str, ...]
    signals: tuple[DbcSignal, ...]

    @property
    def channels(self) -> int:
        return len(self.signals)

    @property
    def buses(self) -> tuple[str, ...]:
        return ("can",)


def dbc_path(table: Table) -> Path:
    """The DBC file's path counts from the profile's. Raises SetupError."""
    return Path(table.file).parent / table.text("dbc")


def can_dbc_profile(name: str, table: Table) -> CanDbcProfile:
    """Read a profile of `protocol = "can_dbc"`. Raises SetupError."""
    path = dbc_path(table)
    try:
        database = cantools.database.load_file(path, database_format="dbc", encoding=DBC_ENCODING)
    except (OSError, DbcError, ValueError) as error:
        raise table.error("dbc", f"{path} cannot be read: {error}") from error
    if not isinstance(database, Database):
        raise table.error("dbc", f"{path} describes no CAN messages")
    messages = {message.name: message for message in database.messages}
    profile = CanDbcProfile(
        name=name,
        title=table.text("title"),
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        signals=tuple(_signal(entry, messages) for entry in table.tables("signal")),
    )
    if not profile.signals:
        raise table.error("signal", "at least one [[signal]] is needed")
    table.finish()
    return profile


def _signal(table: Table, messages: Mapping[str, Message]) -> DbcSignal:
    message = messages[table.text("message", choices=messages)]
    if message.is_multiplexed() or message.is_container:
        raise table.error("message", f"{message.name} is multiplexed or a container, which is not supported")
    signals = {signal.name: signal for signal in message.signals}
    signal = signals[table.text("name", choices=signals)]
    rules = tuple(_rule(entry, signal) for entry in table.tables("invalid"))
    table.finish()
    return DbcSignal(message, signal, rules)


def _rule(table: Table, signal: Signal) -> CodeRule | RangeRule:
    if not (table.has("low") or table.has("high")):
        if signal.is_float:
            raise table.error("mask", f"{signal.name} is a real number and has no bits to look at; state low or high")
        return code_rule(table, _bits(signal))
    if signal.is_float:
        return range_rule(table, None, None)
    least = -(1 << signal.length - 1) if signal.is_signed else 0
    return range_rule(table, least, least + _bits(signal))


def _bits(signal: Signal) -> int:
    return (1 << signal.length) - 1


class CanDbcDevice:
    """A device that sends by itself; `channels` maps names to the profile's signals, counted from 0."""

    def __init__(
        self, device: str, bus: CanBus, profile: CanDbcProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self._device, self._bus = device, bus
        self._signals = {name: profile.signals[number] for name, number in channels.items()}
        self._frames = {signal.frame for signal in self._signals.values()}
        self._maker = ReadingMaker(profile.unit, clock)
        bus.want(self._frames)

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._signals)

    async def connect(self) -> None:
        """Check that something comes. Raises what the bus raises."""
        await self._bus.latest(self._device, self._frames)

    async def read(self) -> Sequence[Reading]:
        """One reading per channel. A message that is missing costs its own channels only."""
        heard = await self._bus.latest(self._device, self._frames)
        return self._maker.make({name: _value(signal, heard) for name, signal in self._signals.items()})

    async def close(self) -> None:
        """Nothing of a device's own stays open."""


def _value(signal: DbcSignal, heard: Mapping[FrameId, bytes]) -> float | Fault:
    data = heard.get(signal.frame)
    if data is None:
        return Fault(Quality.COMM_FAULT, f"message {signal.message.name} (0x{signal.frame[0]:X}) did not come")
    return signal.decode(data)
