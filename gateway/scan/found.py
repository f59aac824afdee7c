"""The result of a scan: places and the devices on them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan

from drivers.base import Bus, DriverError, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.recognition import Recognition

Stopped = Callable[[], bool]
"""Asked between two requests: shall the scan end?"""
Progress = Callable[[int, str], None]
"""Told how many requests are done, and which is next."""


@dataclass(frozen=True, slots=True)
class Found:
    """A device at one address."""

    unit: int
    what: Recognition
    reads: str = ""
    """What its inputs show now, or why they cannot be read."""


@dataclass(frozen=True, slots=True)
class Place:
    """One bus as it was reached, with what answered there."""

    kind: str
    """As `kind` of a `[[bus]]`."""
    options: Mapping[str, object]
    """Its other fields, as far as they are known."""
    devices: tuple[Found, ...] = ()

    @property
    def title(self) -> str:
        """For a table's heading."""
        return f"{self.kind} " + ", ".join(str(value) for value in self.options.values())


@dataclass(slots=True)
class Report:
    """All that a scan has to say."""

    places: list[Place] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    """What was noticed besides, in words."""
    question: str = ""
    """To be answered with yes before the scan can go on."""
    asked: int = 0
    total: int = 0

    @property
    def found(self) -> Sequence[Found]:
        return [device for place in self.places for device in place.devices]


async def read_inputs(bus: Bus, unit: int, what: Recognition) -> str:
    """What a recognised device's inputs show now, in short."""
    if not what.profile:
        return ""
    names = {f"in{number}": number for number in what.inputs}
    driver = make_device("found", bus, what.profile, unit, names, what.options, SystemClock())
    try:
        await driver.connect()
        return _shown(await driver.read())
    except DriverError as error:
        return f"{type(error).__name__}: {error.what}"
    finally:
        await driver.close()


def _shown(readings: Sequence[Reading]) -> str:
    words = []
    for reading in readings:
        good = reading.quality is Quality.GOOD and not isnan(reading.value)
        words.append(f"{reading.value:.1f}" if good else reading.quality.value)
    return " ".join(words) + (f" {readings[0].unit}" if readings else "")
