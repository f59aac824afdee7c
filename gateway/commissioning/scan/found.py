"""The result of a scan: places and the devices on them."""

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from drivers.base import Bus, ConnectError, DriverError
from drivers.build import make_device
from drivers.recognition import Recognition
from gateway.acquisition.line import Line
from gateway.acquisition.once import read_once
from gateway.acquisition.text import reading_text
from gateway.runtime.boundary import UnexpectedError, contained
from gateway.runtime.clocks import RealClock

ScanProgress = Callable[[int, str], None]
"""Receives the number of requests done, and the next one."""


@dataclass(frozen=True, slots=True)
class Found:
    """A device at one address."""

    unit: int
    what: Recognition
    reads: str = ""
    """The present values of its inputs, or why they cannot be read."""


@dataclass(frozen=True, slots=True)
class Place:
    """One bus as it was reached, and the devices that answered on it."""

    kind: str
    """The `kind` of a `[[bus]]`."""
    options: Mapping[str, object]
    """Its other fields, as far as they are known."""
    devices: tuple[Found, ...] = ()

    @property
    def title(self) -> str:
        """The place in words, for a table's heading."""
        return f"{self.kind} " + ", ".join(str(value) for value in self.options.values())


@dataclass(slots=True)
class ScanReport:
    """The report of a scan."""

    places: list[Place] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    """Further remarks."""
    question: str = ""
    """A question that must be answered with yes before the scan can continue."""
    asked: int = 0
    total: int = 0

    @property
    def found(self) -> Sequence[Found]:
        return [device for place in self.places for device in place.devices]


@asynccontextmanager
async def open_bus(bus: Bus) -> AsyncIterator[None]:
    """The bus is connected inside, and closed at the end whatever happened. Raises DriverError."""
    try:
        await contained(bus.connect(), "connect")
        yield
    finally:
        with suppress(UnexpectedError):
            await contained(bus.close(), "close")


async def read_inputs(bus: Bus, unit: int, what: Recognition) -> str:
    """A recognised device's present inputs, in short. The bus is open and stays open."""
    if not what.profile:
        return ""
    clock = RealClock()
    names = {f"in{number}": number for number in what.inputs}
    driver = make_device("found", bus, what.profile, unit, names, what.options, clock)
    (answer,) = await read_once(Line(bus, (driver,)), clock, keep_open=True)
    if isinstance(answer.error, ConnectError | OSError):  # the bus was closed with it
        with suppress(ConnectError, UnexpectedError):
            await contained(bus.connect(), "connect")
    if isinstance(answer.error, DriverError):
        return f"{type(answer.error).__name__}: {answer.error.what}"
    if answer.took_s is None:
        return answer.readings[0].detail
    units = [reading.unit for reading in answer.readings]
    if len(set(units)) > 1:
        return ", ".join(f"{reading_text(r)} {r.unit}" for r in answer.readings)
    return " ".join(map(reading_text, answer.readings)) + f" {units[0]}"
