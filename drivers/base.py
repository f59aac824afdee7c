"""The interface of drivers and buses: construct (validates, no network), connect, read, close.

Within one read a driver may wait, ask again or reopen its connection, as far as the bus's timeout and `limit` allow.
Whoever calls it decides when a device that failed is read again (gateway/acquisition).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from time import monotonic
from typing import Protocol, runtime_checkable

from drivers.text import Text, plain


class Quality(StrEnum):
    """How far a value can be trusted, as the device, the wire or a stated check reports it; never inferred from the
    number."""

    GOOD = "good"
    STALE = "stale"
    COMM_FAULT = "comm_fault"
    SENSOR_FAULT = "sensor_fault"
    OUT_OF_RANGE = "out_of_range"

    @property
    def usable(self) -> bool:
        """Whether the value was measured and nothing indicates that it is wrong."""
        return self is Quality.GOOD


class Clock(Protocol):
    """The source of a reading's two times. Simulated time implements it too."""

    def monotonic(self) -> float:
        """Monotonic seconds, for control; they never jump."""
        ...

    def utc(self) -> datetime:
        """Timezone-aware UTC time, for people; it may jump."""
        ...


class SystemClock:
    """The computer's own clocks."""

    def monotonic(self) -> float:
        return monotonic()

    def utc(self) -> datetime:
        return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Reading:
    """One channel's value as a driver got it."""

    channel: str
    """Name given in the configuration."""
    value: float
    """NaN when there is no value."""
    unit: str
    quality: Quality
    source_time: datetime
    """UTC."""
    monotonic_s: float
    detail: str = ""
    """Why the quality is not good, as text."""


class Driver(Protocol):
    """A device on a bus, constructed from frozen settings. `read` returns one reading per configured channel.

    `read` raises a DriverError when the device as a whole did not answer. A fault of a single sensor is reported as a
    reading with that quality, not as an exception.
    """

    @property
    def device(self) -> str:
        """Name given in the configuration."""
        ...

    @property
    def channels(self) -> tuple[str, ...]: ...

    async def connect(self) -> None:
        """Check that the device answers and is what the profile says (type codes, identity)."""
        ...

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        """One reading per channel.

        again: this repeats the last read, which failed; an answer to that one is accepted too, however late it comes
        """
        ...

    async def close(self) -> None: ...


@runtime_checkable
class AsksLater(Protocol):
    """A driver that leaves out what its device does not answer while it answers the rest, and asks for it again when
    the runner has time; or that checks its device again then."""

    @property
    def asks_later(self) -> bool:
        """Whether something is due to be asked for again."""
        ...

    async def ask_later(self) -> None:
        """Ask for it once; it may take the bus's timeout. What is answered is in the next reading."""
        ...


class Bus(Protocol):
    """A serial port, host or CAN interface with devices on it. It owns the connection that their drivers share."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str:
        """Protocol and wire, as a configuration and the profiles name them, such as `modbus_rtu`."""
        ...

    @property
    def units(self) -> tuple[int, int] | None:
        """Lowest and highest address that a device on this bus can have. None: its devices have no addresses."""
        ...

    @property
    def timeout_s(self) -> float:
        """How long one answer may take at most."""
        ...

    async def connect(self) -> None: ...

    async def close(self) -> None: ...


@runtime_checkable
class LimitedBus(Protocol):
    """A bus whose requests can be told when the time for them ends."""

    def limit(self, left_s: float) -> None:
        """A request that is not answered within `left_s` from now is given up; infinite: no limit."""
        ...


@runtime_checkable
class SharedServer(Protocol):
    """A bus that may leave its server to others between two periods."""

    async def end_period(self) -> None:
        """Nothing is asked until the next period; the bus stays open for its users."""
        ...


@runtime_checkable
class SharedLine(Protocol):
    """A bus that hears what others send on its wire."""

    def other_master(self) -> str:
        """What shows that another master is on the wire, in words; empty if nothing does."""
        ...


@runtime_checkable
class Learns(Protocol):
    """A bus that finds out how its devices want to be asked."""

    def learnt(self) -> Collection[Text]:
        """What is certain by now and not stated in its settings, each with the key that states it."""
        ...

    def answers_s(self) -> Mapping[int, float]:
        """How long each unit that has answered usually takes for its slowest request, s."""
        ...


def dotted(parts: Sequence[str | int]) -> str:
    """`status.rule[1].bit`."""
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts).removeprefix(".")


class DriverError(Exception):
    """An error of a device or its bus. The message says what; bus, device and channel say where; hint, what to do.

    What and hint are texts with a code (drivers/text.py), so that they can be said in other languages, or plain words.
    """

    hurried = False
    """See NoAnswer."""
    heard = False
    """Whether the device was heard: it is not silent, although this answer cannot be used."""
    field: tuple[str | int, ...] = ()
    """See SetupError."""

    def __init__(self, what: str, *, bus: str = "", device: str = "", channel: str = "", hint: str = "") -> None:
        self.what, self.bus, self.device, self.channel, self.hint = plain(what), bus, device, channel, plain(hint)
        where = [Text(k, name=v) for k, v in (("bus", bus), ("device", device), ("channel", channel)) if v]
        said = Text("at_field", field=dotted(self.field), what=self.advice) if self.field else self.advice
        super().__init__(Text("at_place", where=where, what=said) if where else said)

    @property
    def advice(self) -> Text:
        """What, and what to do, for where the place is known."""
        return Text("with_hint", what=self.what, hint=self.hint) if self.hint else self.what


@contextmanager
def placed(bus: str, device: str = "") -> Iterator[None]:
    """Inside, errors of a connection that several devices share, which name neither, name the bus and the device."""
    try:
        yield
    except DriverError as error:
        raise type(error)(error.what, bus=bus, device=device, hint=error.hint) from error


class SetupError(DriverError, ValueError):
    """The settings cannot work: unknown profile, channel or unit id out of range. Raised on construction, offline, also
    by validators, from which pydantic passes it on.

    field: where the wrong value is, below the settings or the validator's own field
    """

    def __init__(self, what: str, *, field: Sequence[str | int] = (), **where: str) -> None:
        self.field = tuple(field)
        super().__init__(what, **where)


class ConnectError(DriverError):
    """The bus cannot be opened: the port is missing or in use, or the host refuses the connection."""


class NoAnswer(DriverError):
    """The device did not answer in time.

    heard: it is not silent, as late answers of it have arrived
    hurried: the device was given less than the bus's timeout because it usually answers quickly; next time it is given
    more
    """

    def __init__(self, what: str, *, hurried: bool = False, heard: bool = False, **where: str) -> None:
        super().__init__(what, **where)
        self.hurried, self.heard = hurried, heard


class BadAnswer(DriverError):
    """The answer does not fit the request: wrong checksum, length or unit.

    heard: whether the bytes are plausibly the device's own
    """

    def __init__(self, what: str, *, heard: bool = True, **where: str) -> None:
        super().__init__(what, **where)
        self.heard = heard


class Refused(DriverError):
    """The device or control understood the request and refused it: exception code, access denied.

    absent: the device does not have what was asked for, so that it would refuse the same request again
    reason: what the device itself gives as its reason
    """

    heard = True

    def __init__(self, what: str, *, absent: bool = False, reason: str = "", **where: str) -> None:
        super().__init__(what, **where)
        self.absent, self.reason = absent, reason


class Busy(Refused):
    """The device cannot answer just now and wants to be asked again."""


class WrongDevice(DriverError):
    """The device that answers is not the configured one (type code, identity)."""
