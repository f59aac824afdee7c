"""Takes the commands of people who have proved who they are: each is answered, reported and stored.

Of those that are refused because there are too many, or because nobody proved anything, a few are stored.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import datetime
from typing import Protocol, assert_never

from gateway.acquisition.reload import ReloadError
from gateway.model.codes import NoticeCode
from gateway.model.commands import BY_CAUTION, UNPROVED, Command, CommandName, CommandOutcome, Disarmed, Pause, Refusals
from gateway.model.events import CommandGiven, EventReported, Sink
from gateway.model.probing import Outlook
from gateway.model.standing import Standing
from gateway.model.text import NOTHING, Text, failure, text_of
from gateway.model.wording import event_of
from gateway.nc.link import NcLink
from gateway.runtime.clocks import ServiceClock
from gateway.storage.faults import StoreError
from talc.frame import EventKind

log = logging.getLogger(__name__)

_MOST = 20
"""Commands that are taken within that time, so that a program that repeats one does not fill the disk."""
_WITHIN_S = 60.0
"""The time within which they are counted."""


class Orders(Protocol):
    """What measures, for commands."""

    def order(self) -> Outlook:
        """Asks for a measurement, and returns how it stands."""
        ...

    def renew_reference(self, by: str) -> bool:
        """Drops the reference, and returns whether there was one."""
        ...


AskReload = Callable[[], Awaitable[Text]]
"""Checks the file again and begins to apply it; returns what happens now. Raises ReloadError."""


class CommandTaker:
    """One gateway's commands, one after the other in the order in which they come.

    A pause and a disarming take effect at once. Anything else must be known to reach the disk first: what a restart
    would forget must not make the machine move.

    Parameters
    ----------
    link: the control; None: there is none
    measuring: asks for measurements
    sink: receives CommandGiven and its event
    on_disk: returns when what the sink received so far can no longer be lost, or raises StoreError
    reload: None: there is no file to read again
    """

    def __init__(
        self,
        link: NcLink | None,
        measuring: Orders,
        clock: ServiceClock,
        sink: Sink,
        on_disk: Callable[[], Awaitable[None]],
        reload: AskReload | None = None,
    ) -> None:
        self._link, self._measuring, self._clock = link, measuring, clock
        self._sink, self._on_disk = sink, on_disk
        self._reload = reload
        self._turn = asyncio.Lock()
        self._taken_s = deque[float](maxlen=_MOST)
        self._refusals = Refusals()

    async def take(self, command: Command, refused: Text = NOTHING) -> CommandOutcome:
        """Obey, or refuse. refused: why this person may not give it, or nobody proved to be one; empty: they may."""
        at, stands = self._clock.utc(), self._stands(command)
        at_once: tuple[bool, Text] | None = None
        if command.name in BY_CAUTION and not refused and command.by != UNPROVED:
            at_once = await self._obeyed(command, at)  # the one before may be waiting for a disk or a file
        async with self._turn:
            now_s = self._clock.monotonic()
            if command.by == UNPROVED:  # must not use up what operators may give; the door lets few of them pass
                why = refused or Text(NoticeCode.UNPROVED)
                outcome = CommandOutcome(command, at, accepted=False, text=why)
                self._report(outcome)
                return outcome
            too_many = self._too_many(now_s)
            if too_many and at_once is not None and stands and self._stands(command):
                return CommandOutcome(command, at, *at_once)  # changes nothing: not stored
            if too_many and (command.name not in BY_CAUTION or refused):
                outcome = CommandOutcome(command, at, accepted=False, text=Text(NoticeCode.TOO_MANY_COMMANDS))
                if (text := self._refusals.stored(outcome.text, now_s)) is not None:
                    self._report(replace(outcome, text=text))
                return outcome
            self._taken_s.append(now_s)
            if not refused and command.name not in BY_CAUTION and (why := await self._unstored()):
                refused = Text(NoticeCode.NOT_STORABLE, why=why)
            if at_once is None or not self._stands(command):  # the one before it may have ended it
                at_once = (False, refused) if refused else await self._obeyed(command, at)
            outcome = CommandOutcome(command, at, *at_once)
            self._report(outcome)
            if why := await self._unstored():
                outcome = replace(outcome, text=Text(NoticeCode.NOT_STORED_YET, text=outcome.text, why=why))
            return outcome

    def _too_many(self, now_s: float) -> bool:
        return len(self._taken_s) == _MOST and now_s - self._taken_s[0] < _WITHIN_S

    def _stands(self, command: Command) -> bool:
        """Whether a pause or a disarming changes nothing."""
        link = self._link
        return link is None or (link.paused if command.name is CommandName.PAUSE else link.disarmed) is not None

    async def _obeyed(self, command: Command, at: datetime) -> tuple[bool, Text]:
        """Whether it was obeyed, and what happens now or why nothing does."""
        if command.name is CommandName.RELOAD:
            return await self._reloaded()
        if self._link is None:
            return False, Text(NoticeCode.NO_CONTROL)
        match command.name:
            case CommandName.MEASURE:
                return self._measured(self._link)
            case CommandName.REFERENCE:
                return self._renewed(self._link, command.by)
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

    async def _reloaded(self) -> tuple[bool, Text]:
        if self._reload is None:
            return False, Text(NoticeCode.NO_FILE)
        try:
            return True, await self._reload()
        except ReloadError as error:
            return False, Text(NoticeCode.NOT_RELOADED, why=text_of(error))

    def _not_probed(self, link: NcLink) -> Text:
        """Why no cycle can be requested at all; empty: one can."""
        if link.disarmed is not None:
            return Text(NoticeCode.ARM_ENDS_THAT, order=link.disarmed.text)
        return NOTHING if link.may_probe else Text(NoticeCode.PROBING_NOT_ARMED)

    def _renewed(self, link: NcLink, by: str) -> tuple[bool, Text]:
        if why := self._not_probed(link):
            return False, why
        renewed = self._measuring.renew_reference(by)
        return True, Text(NoticeCode.REFERENCE_WHEN_IDLE if renewed else NoticeCode.REFERENCE_AWAITED)

    def _measured(self, link: NcLink) -> tuple[bool, Text]:
        if why := self._not_probed(link):
            return False, why
        outlook = self._measuring.order()
        if outlook.standing is Standing.ASKED:
            return True, Text(NoticeCode.MEASUREMENT_UNDER_WAY)
        if outlook.standing is Standing.BLOCKED:
            return True, Text(NoticeCode.MEASUREMENT_WHEN_FREE, reason=outlook.reason)
        return True, Text(NoticeCode.MEASUREMENT_IN_STEP)

    def _paused(self, link: NcLink, pause: Pause) -> tuple[bool, Text]:
        if link.paused is not None:
            return True, Text(NoticeCode.PAUSED_ALREADY, order=link.paused.text)
        link.pause(pause)
        return True, Text(NoticeCode.PAUSED_NOW)

    def _resumed(self, link: NcLink) -> tuple[bool, Text]:
        pause = link.paused
        if pause is None:
            return True, Text(NoticeCode.NOT_PAUSED)
        link.pause(None)
        return True, self._still(link, Text(NoticeCode.RESUMED, order=pause.text))

    def _disarmed(self, link: NcLink, order: Disarmed) -> tuple[bool, Text]:
        if link.disarmed is not None:
            return True, Text(NoticeCode.DISARMED_ALREADY, order=link.disarmed.text)
        link.disarm(order)
        return True, Text(NoticeCode.DISARMED_NOW)

    def _armed(self, link: NcLink) -> tuple[bool, Text]:
        order = link.disarmed
        if order is None:
            return True, self._still(link, Text(NoticeCode.NOT_DISARMED))
        link.disarm(None)
        text = self._still(link, Text(NoticeCode.ARMED_AGAIN, order=order.text))
        return True, text if link.may_probe else Text(NoticeCode.AND_NOT_MEASURED, text=text)

    def _still(self, link: NcLink, text: Text) -> Text:
        """The text, and why nothing is corrected all the same."""
        if not link.armed:
            return Text(NoticeCode.AND_NOTHING_WRITTEN, text=text)
        if link.disarmed is not None:
            return Text(NoticeCode.AND_DISARMED, text=text, order=link.disarmed.text)
        return text if link.paused is None else Text(NoticeCode.AND_PAUSED, text=text, order=link.paused.text)

    def _report(self, outcome: CommandOutcome) -> None:
        command = outcome.command
        code = NoticeCode.COMMAND_ACCEPTED if outcome.accepted else NoticeCode.COMMAND_REFUSED
        text = Text(code, by=command.by, command=command.name.value, text=outcome.text)
        log.warning("%s", text)
        self._sink(CommandGiven(outcome))
        self._sink(EventReported(event_of(EventKind.COMMAND, text), None))

    async def _unstored(self) -> Text:
        """Why what was reported so far may still be lost; empty: it cannot be."""
        try:
            await self._on_disk()
        except StoreError as error:
            return failure(error)
        return NOTHING
