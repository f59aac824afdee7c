"""What a person may tell a running gateway to do, as values."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum


class CommandName(StrEnum):
    """A command. None moves an offset faster than the slew, and none arms what the configuration has not armed."""

    MEASURE = "measure"
    """Request a probing cycle before the end of this grid step, as soon as nothing blocks it."""
    PAUSE = "pause"
    """The compensation goes to its declared state and stays there, restarts included, until it is resumed."""
    RESUME = "resume"
    """The pause ends."""
    DISARM = "disarm"
    """The offsets go to zero and stay there, and no cycle is requested, restarts included, until it is armed again."""
    ARM = "arm"
    """The disarming ends: what the configuration arms is armed again, and nothing else."""
    RELOAD = "reload"
    """Read the configuration's file again and apply it, if nothing in it needs a restart."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of a person who has proved to be who they say."""

    name: CommandName
    by: str


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """What became of a command."""

    command: Command
    time: datetime
    accepted: bool
    text: str
    """What happens now, or why nothing does."""


@dataclass(frozen=True, slots=True)
class StandingOrder:
    """Of a person, until a person ends it; a restart does not."""

    by: str
    since: datetime


@dataclass(frozen=True, slots=True)
class Pause(StandingOrder):
    """The compensation is paused."""

    def __str__(self) -> str:
        return f"paused by {self.by} since {self.since:%Y-%m-%d %H:%M} UTC"


@dataclass(frozen=True, slots=True)
class Disarmed(StandingOrder):
    """A person has disarmed the gateway."""

    def __str__(self) -> str:
        return f"disarmed by {self.by} since {self.since:%Y-%m-%d %H:%M} UTC"
