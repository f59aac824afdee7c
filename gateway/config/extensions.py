"""Controls, buses and outlets of other packages, found by their entry points; see docs/extensions.md.

A package is loaded only when the file uses a kind that the gateway does not have, or when `check` looks at all of them.
"""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, TypeVar

from drivers.base import Bus, Clock, Driver, DriverError, SetupError, SystemClock
from drivers.nc import NumericalControl
from drivers.section import Positive
from drivers.tap import Tap
from gateway.config.polled import Polled, PolledControl
from gateway.config.problems import Problem
from gateway.config.sections import Device

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
        return 500.0

    def other_states(self, name: str) -> str:  # noqa: ARG002
        """Hint for an unknown state."""
        return ""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. May read files."""
        yield from ()

    def settings(self, poses_deg: Poses, states: Iterable[str]) -> None:
        """For `check`: whatever `control` finds. Raises SetupError, also for a bug of the package."""
        asked(self.kind, lambda: self.control(poses_deg, states, SystemClock()))


class OtherBus(Polled, ABC):
    """`[[bus]]` of a kind of another package, whose class derives from it and has `kind: Literal["..."]`."""

    kind: str
    """The entry point's name."""
    timeout_s: Positive = 1.0
    """How long one answer may take."""

    @property
    @abstractmethod
    def place(self) -> str:
        """What no two buses may share, such as `host:port`."""

    @abstractmethod
    def bus(self, tap: Tap | None) -> Bus:
        """The bus. tap: receives everything that passes on the wire. Uses no network."""

    @abstractmethod
    def driver(self, device: Device, bus: Bus, clock: Clock) -> Driver:
        """The driver of a device on this bus; the package says what `profile`, `unit` and `options` mean.

        Raises SetupError naming device, channel and value; uses no network.
        """

    def check(self, device: Device) -> None:
        """For `check`: whatever `driver` finds. Raises SetupError, also for a bug of the package."""
        asked(self.kind, lambda: self.driver(device, self.bus(None), SystemClock()))


def asked(kind: str, question: Callable[[], T]) -> T:
    """What the section of a kind answers. Raises SetupError, also for a bug of its package."""
    try:
        return question()
    except DriverError:
        raise
    except Exception as error:
        raise SetupError(f"the package of kind '{kind}' failed: {type(error).__name__}: {error}") from error


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
        is_one = isinstance(found, type) and issubclass(found, base)
        if not is_one:
            public = ".".join(base.__module__.split(".")[:2])
            raise self._unusable(f"{self.entry.value} is not a class derived from {public}.{base.__name__}")
        if inspect.isabstract(found):
            missing = ", ".join(sorted(found.__abstractmethods__))
            raise self._unusable(f"{self.entry.value} does not define {missing}")
        kind = found.model_fields.get("kind")
        allowed = getattr(None if kind is None else kind.annotation, "__args__", ())
        if allowed != (self.kind,):
            raise self._unusable(f'{self.entry.value} has kind {allowed}: expected Literal["{self.kind}"]')
        made: type[Any] = found
        return made

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
