"""`[[bus]]` of every family of drivers: its settings, which say where it is, with the polling of any bus added."""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, cast

from pydantic import Field, create_model

from drivers.base import Bus, Clock, Driver, SetupError
from drivers.build import bus_from_settings, check_device, make_device
from drivers.bus_settings import BusSettings
from drivers.families import BUS_KINDS
from drivers.profiles import is_users, load_profile, profile_names
from drivers.tap import Tap
from gateway.config.polled import BusSection, ProfileOf, refused
from gateway.config.problems import Problem, suggestion
from gateway.config.reading import any_section_of
from gateway.config.sections import Device
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


class FamilyBus(BusSection):
    """A bus of a family, whose devices have profiles. Its class derives from the family's settings too."""

    def problems(self, devices: Sequence[Device], profile_of: ProfileOf) -> Iterator[Problem]:
        """Unknown profiles, and what the drivers would reject: units, channel numbers, options."""
        for device in devices:
            where = f"device '{device.name}', profile"
            if not is_users(device.profile) and device.profile not in profile_names():
                known = suggestion(device.profile, profile_names())
                yield Problem(where, Text(NoticeCode.UNKNOWN_PROFILE, profile=device.profile, advice=known))
                continue
            try:
                profile = profile_of(device)
                loaded = load_profile(profile) if isinstance(profile, str) else profile
            except SetupError as error:
                yield Problem(where, error.advice)
                continue
            try:
                check_device(
                    device.name,
                    self.name,
                    cast("BusSettings", self),
                    loaded,
                    device.unit,
                    device.channels,
                    device.options,
                )
            except SetupError as error:
                yield refused(device.name, error)
                continue
            if loaded.oldest_s is not None and loaded.oldest_s > 3.0 * self.period_s:
                yield Problem(where, Text(NoticeCode.PROFILE_TOO_OLD, why=self.too_old(loaded.oldest_s)))

    def built(
        self, devices: Sequence[Device], profile_of: ProfileOf, tap: Tap | None, clock: Clock
    ) -> tuple[Bus, tuple[Driver, ...]]:
        """Imports the libraries of the family."""
        bus = bus_from_settings(self.name, cast("BusSettings", self), tap)
        return bus, tuple(
            make_device(d.name, bus, profile_of(d), d.unit, d.channels, d.options, clock) for d in devices
        )


@cache
def section_of_settings(settings: type[BusSettings]) -> type[Any]:
    """The section of a kind of bus: its settings, with polling and `kind` added."""
    kind = settings.bus_kind
    named: Any = Literal[kind]  # a value, which a type checker does not follow
    return create_model(
        f"{settings.__name__.removesuffix('Settings')}Section",
        __base__=(settings, FamilyBus),
        __module__=__name__,
        __doc__=settings.__doc__,
        kind=(named, Field(description=f"`{kind}`.")),
    )


SECTIONS = {kind: section_of_settings(settings) for kind, settings in BUS_KINDS.items()}
"""By `kind`, of the families of `drivers`."""
if TYPE_CHECKING:
    AnyBusSection = BusSection
else:  # gateway.config.extended adds those of other packages where a file uses them
    AnyBusSection = any_section_of(SECTIONS.values())
