"""Commands that a person may give to a running gateway, as values."""

from collections import deque
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Final

from gateway.model.codes import NoticeCode
from gateway.model.text import Text

UNPROVED: Final = "(unknown)"
"""Instead of an operator's name, which never has a bracket: of a command whose sender did not prove to be one."""
_MOST_REFUSALS = 10
_WITHIN_S = 3600.0


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
    REFERENCE = "reference"
    """Drop the reference: the sphere is measured anew while no program runs, and errors count from zero again."""
    RELOAD = "reload"
    """Read the configuration's file again and apply it, if nothing in it needs a restart."""


BY_CAUTION: Final = frozenset({CommandName.PAUSE, CommandName.DISARM})
"""These only take away: they count although nothing can be stored, however many were given and whatever else waits."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of a person who has proved to be who they say, or, only to be refused, of UNPROVED."""

    name: CommandName
    by: str


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """What became of a command."""

    command: Command
    time: datetime
    accepted: bool
    text: Text
    """What happens now, or why nothing does."""


class Refusals:
    """Which refused commands are stored: ten an hour, so that nobody fills the disk, and how many others there were."""

    def __init__(self) -> None:
        self._stored_s = deque[float](maxlen=_MOST_REFUSALS)
        self._left_out = 0

    def stored(self, why: Text, now_s: float) -> Text | None:
        """What to store of one that was refused; None: nothing. now_s: monotonic."""
        if len(self._stored_s) == _MOST_REFUSALS and now_s - self._stored_s[0] < _WITHIN_S:
            self._left_out += 1
            return None
        self._stored_s.append(now_s)
        others, self._left_out = self._left_out, 0
        return Text(NoticeCode.MORE_REFUSED, why=why, n=others) if others else why


@dataclass(frozen=True, slots=True)
class StandingOrder:
    """A person's order that lasts until a person ends it; a restart does not end it."""

    by: str
    since: datetime

    @property
    def text(self) -> Text:
        """Who has ordered what, and when."""
        raise NotImplementedError

    def __str__(self) -> str:
        return str(self.text)


@dataclass(frozen=True, slots=True)
class Pause(StandingOrder):
    """The compensation is paused."""

    @property
    def text(self) -> Text:
        """Who has paused it, and when."""
        return Text(NoticeCode.PAUSED_BY, by=self.by, since=self.since)


@dataclass(frozen=True, slots=True)
class Disarmed(StandingOrder):
    """A person has disarmed the gateway."""

    @property
    def text(self) -> Text:
        """Who has disarmed it, and when."""
        return Text(NoticeCode.DISARMED_BY, by=self.by, since=self.since)
