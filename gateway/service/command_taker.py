"""Takes the commands of people who have proved who they are: each is answered, reported and stored.

Of those that are refused because there are too many, or because nobody proved anything, a few are stored.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import datetime
from typing import assert_never

from gateway.acquisition.reload import ReloadError
from gateway.model.commands import UNPROVED, Command, CommandName, CommandOutcome, Disarmed, Pause, Refusals
from gateway.model.events import CommandGiven, EventReported, Sink
from gateway.model.standing import Standing
from gateway.nc.link import NcLink
from gateway.nc.probing.schedule import Outlook
from gateway.runtime.clocks import ServiceClock
from gateway.storage.faults import StoreError
from talc.frame import Event, EventKind

log = logging.getLogger(__name__)

_MOST, _WITHIN_S = 20, 60.0
"""Commands that are taken, so that a program that repeats one does not fill the disk."""
_NO_CONTROL = "there is no control: [nc] is missing"
_BY_CAUTION = frozenset({CommandName.PAUSE, CommandName.DISARM})
"""These only take away: they count although nothing can be stored, and however many were given."""


AskReload = Callable[[], Awaitable[str]]
"""Checks the file again and begins to apply it; returns what happens now. Raises ReloadError."""


class CommandTaker:
    """One gateway's commands, one after the other in the order in which they come.

    A pause and a disarming take effect at once. Anything else must be known to reach the disk first: what a restart
    would forget must not make the machine move.

    Parameters
    ----------
    link: the control; None: there is none
    measure_now: asks for a measurement, and returns how it stands
    sink: receives CommandGiven and its event
    on_disk: returns when what the sink received so far can no longer be lost, or raises StoreError
    reload: None: there is no file to read again
    """

    def __init__(
        self,
        link: NcLink | None,
        measure_now: Callable[[], Outlook],
        clock: ServiceClock,
        sink: Sink,
        on_disk: Callable[[], Awaitable[None]],
        reload: AskReload | None = None,
    ) -> None:
        self._link, self._measure_now, self._clock = link, measure_now, clock
        self._sink, self._on_disk = sink, on_disk
        self.reload = reload
        self._turn = asyncio.Lock()
        self._taken_s = deque[float](maxlen=_MOST)
        self._refusals = Refusals()

    async def take(self, command: Command, refused: str = "") -> CommandOutcome:
        """Obey, or refuse. refused: why this person may not give it, or nobody proved to be one; empty: they may."""
        async with self._turn:
            now_s, at = self._clock.monotonic(), self._clock.utc()
            if command.by == UNPROVED:  # must not use up what operators may give; the door lets few of them pass
                why = refused or "the sender did not prove to be an operator"
                outcome = CommandOutcome(command, at, accepted=False, text=why)
                self._report(outcome)
                return outcome
            if self._too_many(command, now_s):
                outcome = CommandOutcome(command, at, accepted=False, text="too many commands; wait a minute")
                if (text := self._refusals.stored(outcome.text, now_s)) is not None:
                    self._report(replace(outcome, text=text))
                return outcome
            self._taken_s.append(now_s)
            if not refused and command.name not in _BY_CAUTION and (why := await self._unstored()):
                refused = f"it cannot be stored: {why}"
            accepted, text = (False, refused) if refused else await self._obeyed(command, at)
            outcome = CommandOutcome(command, at, accepted, text)
            self._report(outcome)
            if why := await self._unstored():
                outcome = replace(outcome, text=f"{text}; not stored yet, and a restart would forget it: {why}")
            return outcome

    def _too_many(self, command: Command, now_s: float) -> bool:
        """Whether there were too many; a pause or a disarming that changes something is always taken."""
        link = self._link
        standing = {} if link is None else {CommandName.PAUSE: link.paused, CommandName.DISARM: link.disarmed}
        changes = command.name in standing and standing[command.name] is None
        return len(self._taken_s) == _MOST and now_s - self._taken_s[0] < _WITHIN_S and not changes

    async def _obeyed(self, command: Command, at: datetime) -> tuple[bool, str]:
        """Whether it was obeyed, and what happens now or why nothing does."""
        if command.name is CommandName.RELOAD:
            return await self._reloaded()
        if self._link is None:
            return False, _NO_CONTROL
        match command.name:
            case CommandName.MEASURE:
                return self._measured(self._link)
            case CommandName.PAUSE:
                return self._paused(self._link, Pause(command.by, at))
            case CommandName.RESUME:
                return self._resumed(self._link)
            case CommandName.DISARM:
                return self._disarmed(self._link, Disarmed(command.by, at))
            case CommandName.ARM:
                return self._armed(self._link)
            case _:
                assert_never(command.name)

    async def _reloaded(self) -> tuple[bool, str]:
        if self.reload is None:
            return False, "this gateway has no file to read again"
        try:
            return True, await self.reload()
        except ReloadError as error:
            return False, f"not reloaded; the previous configuration stays in use: {error}"

    def _measured(self, link: NcLink) -> tuple[bool, str]:
        if link.disarmed is not None:
            return False, f"the gateway is {link.disarmed}; `arm` ends that"
        if not link.may_probe:
            return False, "probing is not armed; [probing] armed = true, and a restart, arm it"
        outlook = self._measure_now()
        if outlook.standing is Standing.ASKED:
            return True, "a measurement is under way already"
        if outlook.standing is Standing.BLOCKED:
            return True, f"a measurement is requested as soon as nothing blocks it; now: {outlook.reason}"
        return True, "a measurement is requested before this grid step ends"

    def _paused(self, link: NcLink, pause: Pause) -> tuple[bool, str]:
        if link.paused is not None:
            return True, f"the compensation was {link.paused} already"
        link.pause(pause)
        return True, "the offsets go to their declared state, [compensation] when_stale, and stay there until resumed"

    def _resumed(self, link: NcLink) -> tuple[bool, str]:
        pause = link.paused
        if pause is None:
            return True, "the compensation was not paused"
        link.pause(None)
        return True, f"the compensation continues; it was {pause}{self._still(link)}"

    def _disarmed(self, link: NcLink, order: Disarmed) -> tuple[bool, str]:
        if link.disarmed is not None:
            return True, f"the gateway was {link.disarmed} already"
        link.disarm(order)
        return True, "the offsets go to zero and stay there until somebody arms the gateway; no cycle is requested"

    def _armed(self, link: NcLink) -> tuple[bool, str]:
        order = link.disarmed
        if order is None:
            return True, f"the gateway was not disarmed{self._still(link)}"
        link.disarm(None)
        probing = "" if link.may_probe else "; nothing is measured, because probing is not armed"
        return True, f"armed again as the configuration says; it was {order}{self._still(link)}{probing}"

    def _still(self, link: NcLink) -> str:
        """Why nothing is corrected all the same."""
        if not link.armed:
            return "; nothing is written, because the compensation is not armed or disarmed itself"
        if link.disarmed is not None:
            return f"; nothing is corrected, because the gateway is {link.disarmed}"
        return "" if link.paused is None else f"; nothing is corrected, because the compensation is {link.paused}"

    def _report(self, outcome: CommandOutcome) -> None:
        command = outcome.command
        word = "accepted" if outcome.accepted else "refused"
        text = f"{command.by}: {command.name.value} {word}: {outcome.text}"
        log.warning("%s", text)
        self._sink(CommandGiven(outcome))
        self._sink(EventReported(Event(EventKind.COMMAND, text), None))

    async def _unstored(self) -> str:
        """Why what was reported so far may still be lost; empty: it cannot be."""
        try:
            await self._on_disk()
        except StoreError as error:
            return str(error)
        return ""
