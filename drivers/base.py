"""The interface of drivers and buses: made (validates, no network), connect, read, close. Runners decide the rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from time import monotonic
from typing import Protocol


class Quality(StrEnum):
    """How far a value can be trusted: reported by the device, the wire or a stated check, never inferred from the
    number."""

    GOOD = "good"
    STALE = "stale"
    COMM_FAULT = "comm_fault"
    SENSOR_FAULT = "sensor_fault"
    OUT_OF_RANGE = "out_of_range"
    SUBSTITUTED = "substituted"
    SIMULATED = "simulated"

    @property
    def usable(self) -> bool:
        """Whether the value was measured, or simulated as if it were, and nothing says that it is wrong."""
        return self in (Quality.GOOD, Quality.SIMULATED)


class Clock(Protocol):
    """The two times of a reading. A simulated clock is another implementation."""

    def monotonic(self) -> float:
        """Seconds for control; never jumps."""
        ...

    def utc(self) -> datetime:
        """Aware UTC time for people; may jump."""
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
    """A device on a bus. Made from frozen settings; `read` returns one reading per configured channel.

    `read` raises a DriverError when the device as a whole did not answer; a fault of one sensor is a reading
    with that quality, not an exception.
    """

    @property
    def device(self) -> str:
        """Name given in the configuration."""
        ...

    @property
    def channels(self) -> tuple[str, ...]: ...

    async def connect(self) -> None:
        """Check that the device is there and is what the profile says (type codes, identity)."""
        ...

    async def read(self) -> Sequence[Reading]: ...

    async def close(self) -> None: ...


class Bus(Protocol):
    """Where devices are: a serial port, a host, a CAN interface. Owns the connection its drivers share."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str:
        """Protocol and wire, as a configuration and the profiles name them, such as `modbus_rtu`."""
        ...

    @property
    def units(self) -> tuple[int, int]:
        """Lowest and highest address that a device can have on it."""
        ...

    @property
    def timeout_s(self) -> float:
        """How long one answer may take at most."""
        ...

    async def connect(self) -> None: ...

    async def close(self) -> None: ...


class DriverError(Exception):
    """An error of a device or its bus. The message says what; bus, device, channel say where; hint says what to do."""

    hurried = False
    """See NoAnswer."""

    def __init__(self, what: str, *, bus: str = "", device: str = "", channel: str = "", hint: str = "") -> None:
        self.what, self.bus, self.device, self.channel, self.hint = what, bus, device, channel, hint
        where = ", ".join(f"{k} {v}" for k, v in (("bus", bus), ("device", device), ("channel", channel)) if v)
        super().__init__((f"{where}: " if where else "") + what + (f" ({hint})" if hint else ""))


class SetupError(DriverError, ValueError):
    """The settings cannot work: unknown profile, channel or unit id out of range. Raised when made, without network."""


class ConnectError(DriverError):
    """The bus cannot be opened: port missing or in use, host refuses."""


class NoAnswer(DriverError):
    """The device did not answer in time.

    hurried: it was given less than the bus's timeout, because it usually is quick; next time it is given the full
    timeout, and need not be checked again
    """

    def __init__(self, what: str, *, hurried: bool = False, **where: str) -> None:
        super().__init__(what, **where)
        self.hurried = hurried


class BadAnswer(DriverError):
    """The answer is not a valid answer to the request: checksum, length, wrong unit."""


class Refused(DriverError):
    """The device or control understood the request and refused it: exception code, access denied."""


class WrongDevice(DriverError):
    """The device that answers is not the configured one (type code, identity)."""
