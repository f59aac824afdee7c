"""What any `[[bus]]` and any `[nc]` have: how the gateway polls them, and what the program asks of them."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar, Final

from pydantic import Field

from drivers.base import Bus, Clock, Driver, SetupError
from drivers.bus_settings import AnyBus
from drivers.profile import DeviceProfile
from drivers.section import Positive, Section
from drivers.tap import Tap
from gateway.config.fields import Name
from gateway.config.problems import Problem
from gateway.config.sections import Device
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

PERIOD_S: Final = 1.0
READ_LIMIT_S: Final = 10.0
RETRY_MAX_PERIODS: Final = 60
"""How a bus is polled of which nothing is stated."""
ProfileOf = Callable[[Device], str | DeviceProfile]
"""A device's profile: its name, or the content of the user's own."""


class BusSection(AnyBus):
    """`[[bus]]` of any kind."""

    has_profiles: ClassVar[bool] = True
    """Whether `profile` of its devices is one of those that `drivers.profiles` loads."""

    name: Name
    """Name by which devices and messages refer to the bus."""
    period_s: Positive = PERIOD_S
    """Every device of the bus is read once in each period."""
    read_limit_s: Positive = READ_LIMIT_S
    """How long one whole read of a device may take; after that the bus is closed and opened again."""
    retry_max_periods: int = Field(default=RETRY_MAX_PERIODS, ge=1, le=3600)
    """A silent device, or a bus that does not open, is tried again after 1, 2, 4 ... periods, up to this number."""

    if TYPE_CHECKING:  # fields of each kind
        kind: str
        timeout_s: float

    def check_answers(self, devices: Sequence[Device]) -> None:
        """Whether what the rules and commands will ask has an answer of its type. Raises SetupError."""

    @abstractmethod
    def problems(self, devices: Sequence[Device], profile_of: ProfileOf) -> Iterator[Problem]:
        """What would keep this bus and its devices from being made. Uses no network."""

    @abstractmethod
    def built(
        self, devices: Sequence[Device], profile_of: ProfileOf, tap: Tap | None, clock: Clock
    ) -> tuple[Bus, tuple[Driver, ...]]:
        """The bus and its devices. tap: receives everything that passes on the wire. Raises SetupError."""

    def too_old(self, age_s: float) -> Text:
        """Why a value of this age, longer than three periods, is a mistake."""
        return Text(NoticeCode.OLDER_THAN_PERIODS, age_s=age_s, most_s=3.0 * self.period_s, bus=self.name)


def refused(device: str, error: SetupError) -> Problem:
    """What a driver rejects, in the place of its device or channel."""
    where = f"device '{device}'"
    return Problem(f"{where}, channels.{error.channel}" if error.channel else where, error.advice, error.field)


class PolledControl(Section):
    """How the gateway polls a control of any kind, and what that kind can do."""

    period_s: Positive = 1.0
    """Interval at which positions and states are read and compensation, if any, is written."""

    largest_is: ClassVar[str] = "the driver's largest_um"
    """What bounds the offsets, in words."""
    only_read: ClassVar[bool] = False
    """Whether it can only be read: `check` then accepts neither armed probing nor `mode = "compensate"`."""
