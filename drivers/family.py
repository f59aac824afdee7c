"""What a family of buses and devices registers: its kinds of bus, its profiles, and how its drivers are made.

Each family has a module `family` with its `FAMILY`. Whatever loads the family's libraries is imported in the functions
that make a bus or a driver.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from drivers.base import Bus, Clock, Driver, SetupError
from drivers.bus_settings import BusSettings
from drivers.profile import DeviceProfile
from drivers.section import Section
from drivers.tap import Tap
from drivers.text import Text

S = TypeVar("S", bound=BusSettings)
P = TypeVar("P", bound=DeviceProfile)
O = TypeVar("O", bound=Section)  # noqa: E741


class NoOptions(Section):
    """Options of a device type that has none."""


@dataclass(frozen=True, slots=True)
class PlacedDevice(Generic[P, O]):
    """A device on a bus, with its options read."""

    name: str
    bus: str
    profile: P
    unit: int
    channels: Mapping[str, int]
    """Channel name to the device's channel number."""
    options: O

    def error(self, what: Text, *, field: Sequence[str] = (), channel: str = "", hint: str = "") -> SetupError:
        """The error that names this device."""
        return SetupError(what, field=field, bus=self.bus, device=self.name, channel=channel, hint=hint)

    def foreign(self, bus: Bus) -> SetupError:
        """The error of a bus that the family did not make."""
        return self.error(Text("bus_foreign", kind=type(bus).__name__))


@dataclass(frozen=True, slots=True)
class BusKind(Generic[S]):
    """One kind of bus."""

    settings: type[S]
    make: Callable[[str, S, Tap | None], Bus]
    """Called with the bus's name, its settings and the tap."""


def _nothing_more(device: PlacedDevice[Any, Any]) -> None:
    """Nothing is to be checked that profile and options do not check themselves."""


@dataclass(frozen=True, slots=True)
class DeviceKind(Generic[P, O]):
    """The devices of one type of profile."""

    profile: type[P]
    options: type[O]
    """`NoOptions` for none."""
    make: Callable[[PlacedDevice[P, O], Bus, Clock], Driver]
    check: Callable[[PlacedDevice[P, O]], None] = _nothing_more
    """Raises SetupError for options that do not fit the profile."""


@dataclass(frozen=True, slots=True)
class Family:
    """Kinds of bus and of device that belong together."""

    buses: tuple[BusKind[Any], ...]
    devices: tuple[DeviceKind[Any, Any], ...]
