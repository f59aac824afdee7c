"""A scenario: what an emulated device measures and which faults it has over time.

A scenario is TOML: `[[at]]` tables in the order of time, each with `s` and some of

- `values`: of all channels; between two of these a channel changes linearly, and before the first and after the last it
  is constant;
- `fault` and `channel`: the channel's sensor breaks (`open`, `short`, `over`, `under`);
- `mend`: number of the channel whose sensor is whole again;
- `type_code` and `channel`: the channel is set to another type of sensor;
- the keys of SWITCHES, with the values they expect. Each stays as it is until another entry changes it.

Not every device can have all of them: `check` compares.
"""

import bisect
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Protocol

from simulators.devices.source import Actions, SensorFault, ValueSource


def _is_truth(value: object) -> bool:
    return isinstance(value, bool)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _is_duration(value: object) -> bool:
    return isinstance(value, int | float) and _is_number(value) and value >= 0


def _is_whole(most: int) -> Callable[[object], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


_TRUTH = "true or false"
_CODE = 0xFFFF
SWITCHES: Mapping[str, tuple[str, Callable[[object], bool]]] = {
    "silent": (_TRUTH, _is_truth),  # it receives requests and does not answer
    "delay_s": ("seconds, 0 to end it", _is_duration),  # each answer is delayed by this
    "crc": (_TRUTH, _is_truth),  # its answers have a wrong checksum
    "truncated": (_TRUTH, _is_truth),  # its answers end too early
    "exception": ("a Modbus exception code up to 255, 0 to end it", _is_whole(255)),
    "abort": ("an SDO abort code of 32 bits, 0 to end it", _is_whole(0xFFFF_FFFF)),
    "heartbeat": (_TRUTH, _is_truth),  # false: it stops, everything else continues
    "emcy": ("an emergency's code up to 0xFFFF; 0 takes it back", _is_whole(_CODE)),  # sent once
    "reboot": ("true", lambda value: value is True),  # it restarts and sends its boot-up, also after `silent`
}
"""Faults of a device or its wire, in the order in which those of one entry take effect: expected value, and check."""
_KEYS = {"s", "values", "fault", "channel", "mend", "type_code", *SWITCHES}


class NotOfThisDeviceError(ValueError):
    """The scenario contains an event that this device cannot have."""


class PlayClock(Protocol):
    """The time in which a scenario is played; simulated or real."""

    def monotonic(self) -> float: ...

    async def sleep_until(self, monotonic_s: float) -> None: ...


@dataclass(frozen=True, slots=True)
class _Change:
    at_s: float
    where: str
    """Entry and key, for a person."""
    action: str
    value: object


@dataclass(frozen=True, slots=True)
class Scenario:
    """The channels' values and faults, by seconds since the start of the scenario."""

    _times: list[float] = field(default_factory=list)
    _values: list[Sequence[float]] = field(default_factory=list)
    _changes: list[_Change] = field(default_factory=list)
    _named: list[tuple[str, int]] = field(default_factory=list)
    """Channels with an event, and where the scenario states it."""

    @classmethod
    def parse(cls, text: str) -> "Scenario":
        """Raises ValueError naming the entry, the key and the value."""
        scenario, before = cls(), 0.0
        for number, entry in enumerate(tomllib.loads(text).get("at", ())):
            where = f"at[{number}]"
            if unknown := set(entry) - _KEYS:
                raise ValueError(f"{where}: unknown key {min(unknown)!r}; known: {', '.join(sorted(_KEYS))}")
            at_s = entry.get("s")
            if not isinstance(at_s, int | float) or not before <= at_s < inf:
                raise ValueError(f"{where}.s = {at_s!r}: expected seconds, not before {before:g}")
            before = float(at_s)
            scenario._add(where, before, entry)
        if not scenario._times:
            raise ValueError("no entry with `values`: at least one is needed")
        for where, channel in scenario._named:
            if channel >= scenario.channels:
                raise ValueError(f"{where} = {channel}: `values` has channels 0 to {scenario.channels - 1}")
        return scenario

    @property
    def channels(self) -> int:
        """How many values there are."""
        return len(self._values[0])

    def check(self, device: str, actions: Collection[str]) -> None:
        """Raises NotOfThisDeviceError naming the first entry with a fault that this device cannot have."""
        for change in self._changes:
            if change.action not in actions:
                has = ", ".join(sorted(actions))
                raise NotOfThisDeviceError(f"{change.where}: {device} cannot have this; possible: {has}")

    def values(self, time_s: float) -> list[float]:
        """Values of all channels at this time."""
        after = bisect.bisect_right(self._times, time_s)
        if after == 0:
            return list(self._values[0])
        if after == len(self._times):
            return list(self._values[-1])
        begin, end = self._times[after - 1], self._times[after]
        part = (time_s - begin) / (end - begin)
        return [a + (b - a) * part for a, b in zip(self._values[after - 1], self._values[after], strict=True)]

    def source(self, clock: PlayClock) -> ValueSource:
        """A value source for a device; the scenario starts now."""
        began = clock.monotonic()
        return lambda: self.values(clock.monotonic() - began)

    async def play(self, actions: Actions, clock: PlayClock) -> None:
        """Break and repair the device over time; the scenario starts now. Ends with its last change."""
        began = clock.monotonic()
        for change in self._changes:
            await clock.sleep_until(began + change.at_s)
            actions[change.action](change.value)

    def _add(self, where: str, at_s: float, entry: dict[str, object]) -> None:
        if entry.get("values") is not None:
            self._add_values(where, at_s, entry["values"])
        if "fault" in entry:
            kind, channel = entry["fault"], _channel(where, "channel", entry.get("channel"))
            if str(kind) not in set(SensorFault):
                raise ValueError(f"{where}.fault = {kind!r}: expected one of {', '.join(SensorFault)}")
            self._changes.append(_Change(at_s, f"{where}.fault", "fault", (channel, SensorFault(str(kind)))))
            self._named.append((f"{where}.channel", channel))
        if "mend" in entry:
            mended = _channel(where, "mend", entry["mend"])
            self._changes.append(_Change(at_s, f"{where}.mend", "fault", (mended, None)))
            self._named.append((f"{where}.mend", mended))
        if "type_code" in entry:
            code, channel = entry["type_code"], _channel(where, "channel", entry.get("channel"))
            if not _is_whole(_CODE)(code):
                raise ValueError(f"{where}.type_code = {code!r}: expected a code up to 0xFFFF")
            self._changes.append(_Change(at_s, f"{where}.type_code", "type_code", (channel, code)))
            self._named.append((f"{where}.channel", channel))
        for key, (expected, fits) in SWITCHES.items():
            if key in entry:
                if not fits(value := entry[key]):
                    raise ValueError(f"{where}.{key} = {value!r}: expected {expected}")
                self._changes.append(_Change(at_s, f"{where}.{key}", key, value))

    def _add_values(self, where: str, at_s: float, values: object) -> None:
        count = len(self._values[0]) if self._values else None
        if not isinstance(values, list) or not all(_is_number(v) for v in values) or not values:
            raise ValueError(f"{where}.values = {values!r}: expected numbers")
        if count not in (None, len(values)):
            raise ValueError(f"{where}.values = {values!r}: expected {count} of them as before")
        self._times.append(at_s)
        self._values.append([float(v) for v in values])


def _channel(where: str, key: str, value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{where}.{key} = {value!r}: expected a channel's number, from 0")
    return value
