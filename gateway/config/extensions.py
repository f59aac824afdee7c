"""Controls, buses and outlets of other packages, found by their entry points; see docs/own-profile.md.

A package is loaded only when the file uses a kind that the gateway does not have, or when `check` looks at all of them.
"""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property, partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Final, Generic, TypeVar

from pydantic import BaseModel

from drivers.base import Bus, Clock, Driver, DriverError, SetupError, SystemClock
from drivers.families import register
from drivers.family import Family
from drivers.nc import LARGEST_UM, NumericalControl
from drivers.section import ServerTime
from drivers.tap import Tap
from gateway.config.buses import section_of_settings
from gateway.config.polled import BusSection, PolledControl, ProfileOf, refused
from gateway.config.problems import Problem
from gateway.config.sections import Device
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

CONTROLS: Final = "talc_gateway.controls"
BUSES: Final = "talc_gateway.buses"
OUTLETS: Final = "talc_gateway.outlets"
T = TypeVar("T")
Poses = Sequence[tuple[float, float]]
"""A and C of each pose, degrees."""


class ControlSection(PolledControl, ABC):
    """`[nc]` of a kind of another package, whose class derives from it and has `kind: Literal["..."]`."""

    kind: str
    """The entry point's name."""

    @abstractmethod
    def control(self, poses_deg: Poses, states: Iterable[str], clock: Clock) -> NumericalControl:
        """The driver for a probing cycle of these poses. Raises SetupError naming the field; uses no network.

        states: those of `known_states` that models use
        """

    @property
    @abstractmethod
    def address(self) -> str:
        """Where the control is, for messages."""

    @abstractmethod
    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""

    @property
    def largest_um(self) -> float:
        """Larger offsets are never sent."""
        return LARGEST_UM

    def other_states(self, name: str) -> str:  # noqa: ARG002
        """Hint for an unknown state."""
        return ""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. May read files."""
        yield from ()

    def settings(self, poses_deg: Poses, states: Iterable[str]) -> None:
        """For `check`: whatever `control` finds. What it made is kept for `built`.

        Raises SetupError, also for a bug of the package.
        """
        names, clock = tuple(states), _LateClock()
        self._kept.put((self, poses_deg, names), clock, asked(self.kind, lambda: self.control(poses_deg, names, clock)))

    def built(self, poses_deg: Poses, states: Iterable[str], clock: Clock) -> NumericalControl:
        """The driver that the check made, for the first who asks; otherwise another one. Raises SetupError."""
        names = tuple(states)
        return self._kept.take((self, poses_deg, names), clock) or self.control(poses_deg, names, clock)

    @cached_property
    def _kept(self) -> "_Kept[NumericalControl]":
        return _Kept()


class OtherBus(BusSection):
    """`[[bus]]` of a kind of another package, whose class derives from it and has `kind: Literal["..."]`."""

    kind: str
    """The entry point's name."""
    has_profiles: ClassVar[bool] = False
    units: ClassVar[tuple[int, int] | None] = (0, 0xFFFF)
    timeout_s: ServerTime = 1.0
    """How long one answer may take."""

    @abstractmethod
    def bus(self, tap: Tap | None) -> Bus:
        """The bus. tap: receives everything that passes on the wire. Uses no network."""

    @abstractmethod
    def driver(self, device: Device, bus: Bus, clock: Clock) -> Driver:
        """The driver of a device on this bus; the package says what `profile`, `unit` and `options` mean.

        Raises SetupError naming device, channel and value; uses no network.
        """

    def check(self, devices: Sequence[Device]) -> dict[str, SetupError]:
        """For `check`: whatever `bus` and `driver` find, also bugs of the package, by device. What they made is kept
        for `built`."""
        clock, drivers, refused = _LateClock(), list[Driver](), dict[str, SetupError]()
        if not devices:
            return {}
        try:
            bus = asked(self.kind, lambda: self.bus(None))
        except SetupError as error:
            return {device.name: error for device in devices}
        for device in devices:
            try:
                drivers.append(asked(self.kind, partial(self.driver, device, bus, clock)))
            except SetupError as error:
                refused[device.name] = error
        if not refused:
            self._kept.put((self, tuple(devices)), clock, (bus, tuple(drivers)))
        return refused

    def problems(self, devices: Sequence[Device], profile_of: ProfileOf) -> Iterator[Problem]:  # noqa: ARG002
        """Whatever `check` finds."""
        yield from (refused(name, error) for name, error in self.check(devices).items())

    def built(
        self,
        devices: Sequence[Device],
        profile_of: ProfileOf,  # noqa: ARG002
        tap: Tap | None,
        clock: Clock,
    ) -> tuple[Bus, tuple[Driver, ...]]:
        """The bus and its drivers that the check made, for the first who asks without a tap; otherwise other ones.

        Raises SetupError.
        """
        kept = self._kept.take((self, tuple(devices)), clock) if tap is None else None
        if kept is not None:
            return kept
        bus = self.bus(tap)
        return bus, tuple(self.driver(device, bus, clock) for device in devices)

    def check_answers(self, devices: Sequence[Device]) -> None:
        """Whether what the rules and commands will ask has an answer of its type. Raises SetupError, also for a bug of
        the package."""
        asked(self.kind, lambda: self._check_answers(devices))

    def _check_answers(self, devices: Sequence[Device]) -> None:
        is_age = self.timeout_is_age(device.options for device in devices)
        answers: list[tuple[str, object, type[Any]]] = [("place", self.place, str), ("timeout_is_age", is_age, bool)]
        answers += [("unrecorded", self.unrecorded, str), ("only_listens", self.only_listens, bool)]
        answers.append(("several_per_unit", self.several_per_unit, bool))
        for name, pair, of in (("units", self.units, int), ("serial_path", self.serial_path, str)):
            if pair is not None:
                first, second = pair
                answers += [(name, first, of), (name, second, of)]
        for name, answer, of in answers:
            if not isinstance(answer, of):
                raise TypeError(f"{name} is or contains {answer!r}: expected {of.__name__}")

    @cached_property
    def _kept(self) -> "_Kept[tuple[Bus, tuple[Driver, ...]]]":
        return _Kept()


class _LateClock:
    """The computer's clock until it is known which one the driver is to have."""

    def __init__(self) -> None:
        self.clock: Clock = SystemClock()

    def monotonic(self) -> float:
        return self.clock.monotonic()

    def utc(self) -> datetime:
        return self.clock.utc()


class _Kept(Generic[T]):
    """What the check of a section made: only by making it can a package say what is wrong. It is used once, because it
    becomes one connection."""

    def __init__(self) -> None:
        self._made: tuple[object, _LateClock, T] | None = None

    def put(self, made_of: object, clock: _LateClock, made: T) -> None:
        self._made = made_of, clock, made

    def take(self, made_of: object, clock: Clock) -> T | None:
        """None if it is taken already, or was made of something else."""
        if self._made is None or self._made[0] != made_of:
            return None
        _, late, made = self._made
        self._made, late.clock = None, clock
        return made


def asked(kind: str, question: Callable[[], T]) -> T:
    """What the section of a kind answers. Raises SetupError, also for a bug of its package."""
    try:
        return question()
    except DriverError:
        raise
    except Exception as error:
        raise SetupError(
            Text(NoticeCode.PACKAGE_FAILED, kind=kind, type=type(error).__name__, error=str(error))
        ) from error


class ExtensionError(Exception):
    """A package cannot be used; the message is one line."""


@dataclass(frozen=True)
class Extension:
    """One entry point."""

    entry: EntryPoint

    @property
    def kind(self) -> str:
        """As the file names it."""
        return self.entry.name

    @cached_property
    def package(self) -> str:
        """Name and version."""
        dist = self.entry.dist
        return self.entry.value if dist is None else f"{dist.name} {dist.version}"

    def section(self, base: type[Any]) -> type[Any]:
        """The class that the entry point names, derived from `base`. Raises ExtensionError."""
        try:
            found: Any = self.entry.load()
        except (Exception, SystemExit) as error:  # whatever the package does when it is imported
            raise self._unusable(f"{type(error).__name__}: {error}") from error
        if isinstance(found, Family) and base is OtherBus:
            return self._of_family(found)
        is_one = isinstance(found, type) and issubclass(found, base)
        if not is_one:
            public = base.__module__
            raise self._unusable(f"{self.entry.value} is not a class derived from {public}.{base.__name__}")
        if inspect.isabstract(found):
            missing = ", ".join(sorted(found.__abstractmethods__))
            raise self._unusable(f"{self.entry.value} does not define {missing}")
        for field in found.model_fields.keys() - base.model_fields.keys():
            # Pydantic would take a method or a property for the field's default. In the place of a value a field works.
            if hasattr(base, field) and not hasattr(BaseModel, field) and field not in base.__class_vars__:
                raise self._unusable(
                    f"{self.entry.value} has a field {field}, which is a member of {base.__name__}; rename the field"
                )
        kind = found.model_fields.get("kind")
        allowed = getattr(None if kind is None else kind.annotation, "__args__", ())
        if allowed != (self.kind,):
            raise self._unusable(f'{self.entry.value} has kind {allowed}: expected Literal["{self.kind}"]')
        made: type[Any] = found
        return made

    def _of_family(self, family: Family) -> type[Any]:
        kinds = {bus.settings.bus_kind: bus.settings for bus in family.buses}
        if self.kind not in kinds:
            raise self._unusable(f"{self.entry.value} has no bus of this kind")
        try:
            register(family)
        except ValueError as error:
            raise self._unusable(str(error)) from error
        settings: Any = kinds[self.kind]
        section: type[Any] = section_of_settings(settings)
        return section

    def _unusable(self, why: str) -> ExtensionError:
        return ExtensionError(
            f"kind '{self.kind}' of the package {self.package} cannot be used: {' '.join(why.split())}"
        )


def extensions(group: str) -> dict[str, list[Extension]]:
    """Kind to the packages that offer it. group: CONTROLS, BUSES or OUTLETS. Loads none of them."""
    found: dict[str, list[Extension]] = {}
    for entry in entry_points(group=group):
        found.setdefault(entry.name, []).append(Extension(entry))
    return found


def section_of(kind: str, offered: Sequence[Extension], base: type[Any]) -> type[Any]:
    """The class of a kind, derived from `base`. Raises ExtensionError, also when two packages offer it."""
    if len(offered) > 1:
        raise ExtensionError(f"kind '{kind}' is offered by {' and '.join(it.package for it in offered)}; remove one")
    return offered[0].section(base)


def sections_of_others(
    group: str, base: type[Any], own: Collection[str], named: Iterable[tuple[str, str]]
) -> tuple[list[type[Any]], list[Problem]]:
    """The classes of the kinds that a file names and the gateway does not have, and why some cannot be used.

    base: what they derive from
    own: kinds that the gateway has itself
    named: each kind that the file names, and where
    """
    found, problems = dict[str, type[Any]](), list[Problem]()
    for kind, where in named:
        if kind in own:
            continue
        offered = extensions(group)
        for name in [kind] if kind in offered else offered:  # of an unknown kind the message tells all that there are
            try:
                found[name] = section_of(name, offered[name], base)
            except ExtensionError as error:
                if name == kind:
                    problems.append(Problem(where, str(error)))
    return list(found.values()), problems
