"""Receives everything from the machines of a site: a Zenoh subscriber that publishes nothing, and asks."""

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, date, datetime
from time import monotonic
from typing import Self, TypeVar

from gateway.config.telemetry import Telemetry
from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.text import Text
from gateway.telemetry import keys
from gateway.telemetry.answers import CommandAnswer, CoursePage, ReportPage, ScenarioPage
from gateway.telemetry.asking import COMMAND_LIMIT_S, QueryRefusal, ask, command
from gateway.telemetry.codec import decode
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.subscriber.hearing import Hearing
from gateway.telemetry.subscriber.machine import MachineSeen
from gateway.telemetry.subscriber.runs import HeardRuns
from gateway.telemetry.subscriber.unreadable import UnreadableMessages

log = logging.getLogger(__name__)

_MOST_MACHINES = 300
_ANSWER_LIMIT_S = 5.0
_REPORT_LIMIT_S = 150.0
"""A small computer draws for half a minute, and others may be waiting."""
_Answer = TypeVar("_Answer", CoursePage, ReportPage, ScenarioPage)


def listened_to(telemetry: Telemetry) -> tuple[str, ...]:
    """The endpoints at which what this gateway publishes is heard on its own computer."""
    return (*(place.from_here for place in telemetry.listening), *telemetry.connect)


class SiteSeen:
    """The machines under one prefix. Zenoh calls from its own threads; `machines` holds them off.

    Parameters
    ----------
    prefix: first part of every key
    expected: machines that are shown even before anything is heard of them
    now: this computer's UTC
    now_s: this computer's monotonic seconds
    """

    def __init__(
        self,
        prefix: str,
        expected: Iterable[str] = (),
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        now_s: Callable[[], float] = monotonic,
    ) -> None:
        self.prefix, self.now, self.now_s = prefix, now, now_s
        self._lock = threading.Lock()
        self._machines = {name: MachineSeen(name) for name in expected}
        self._full, self._runs = False, HeardRuns(log)
        self._unreadable = UnreadableMessages(log, "not shown")
        self.changed: Callable[[], None] = lambda: None
        """Called from any thread when something was heard."""

    @contextmanager
    def machines(self) -> Iterator[dict[str, MachineSeen]]:
        """By name, as at this moment; nothing changes meanwhile."""
        with self._lock:
            now_s = self.now_s()
            for seen in self._machines.values():
                seen.listen(now_s)
                seen.two = self._runs.two(seen.machine, now_s)
            yield self._machines

    def may_be(self, machine: str) -> bool:
        """Whether there is a machine of this name, or one could be heard of later."""
        return machine in self._machines or keys.MACHINE.fullmatch(machine) is not None

    def take(self, key: str, payload: bytes) -> None:
        """One published message; an invalid one is only reported."""
        machine, _, suffix = key.removeprefix(self.prefix + "/").partition("/")
        try:
            message = decode(suffix, payload)
        except ValueError as error:
            self._unreadable.invalid(machine, suffix, error)
            return
        if message is not None:
            self._unreadable.valid(machine, suffix)
            with self._lock:
                now_s = self.now_s()
                if (seen := self._of(machine)) is not None and self._runs.follows(machine, message.boot, now_s):
                    seen.apply(suffix, message, self.now(), now_s)
            self.changed()

    def life(self, key: str, *, alive: bool) -> None:
        """A liveliness token has appeared or disappeared."""
        machine = key.removeprefix(self.prefix + "/").partition("/")[0]
        with self._lock:
            if (seen := self._of(machine)) is not None:
                seen.appear(self.now()) if alive else seen.disappear(self.now())
        self.changed()

    def _of(self, machine: str) -> MachineSeen | None:
        if machine not in self._machines and keys.MACHINE.fullmatch(machine):
            if len(self._machines) < _MOST_MACHINES:
                self._machines[machine] = MachineSeen(machine)
            elif not self._full:
                self._full = True
                log.warning("%s", Text(NoticeCode.MACHINES_FULL, n=_MOST_MACHINES, machine=machine))
        return self._machines.get(machine)


class SiteSubscription:
    """Feeds a site from Zenoh while it is entered; absent gateways are tried again without end.

    Parameters
    ----------
    site: what takes in the messages
    settings: where to connect to; see `page_config`
    """

    def __init__(self, site: SiteSeen, settings: Telemetry) -> None:
        self._site = site
        self._hearing = Hearing(settings, site.take, self._life)

    def __enter__(self) -> Self:
        self._hearing.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._hearing.__exit__()

    def ask(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        """Stored estimates of a machine. Blocks. Raises OSError with what the gateway says, or that it says nothing."""
        selected = f"from={begin.isoformat()};to={end.isoformat()};limit={limit}"
        return self._asked(machine, f"{keys.COURSE}?{selected}", CoursePage, _ANSWER_LIMIT_S)

    def ask_with_temperatures(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        """The same with the temperatures at each time."""
        selected = f"from={begin.isoformat()};to={end.isoformat()};limit={limit};temperatures=yes"
        return self._asked(machine, f"{keys.COURSE}?{selected}", CoursePage, _ANSWER_LIMIT_S)

    def ask_with_inputs(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        """The same with all inputs at each time; of an earlier program with its temperatures."""
        selected = f"from={begin.isoformat()};to={end.isoformat()};limit={limit};temperatures=yes;inputs=yes"
        try:
            return self._asked(machine, f"{keys.COURSE}?{selected}", CoursePage, _ANSWER_LIMIT_S)
        except QueryRefusal as error:
            if not error.lacks("inputs"):
                raise
            return self.ask_with_temperatures(machine, begin, end, limit)

    def ask_reasons(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        """The same with the learner's latest reasons of the span."""
        selected = f"from={begin.isoformat()};to={end.isoformat()};limit={limit};reasons=yes"
        return self._asked(machine, f"{keys.COURSE}?{selected}", CoursePage, _ANSWER_LIMIT_S)

    def ask_report(
        self, machine: str, day: date, zone: str, language: str, tolerance_um: float | None = None
    ) -> ReportPage:
        """The report of a machine's day, judged by a tolerance; None: by what part programs stated. Blocks. Raises
        OSError with what the gateway says, or that it says nothing."""
        selector = f"{keys.REPORT}?day={day.isoformat()};zone={zone}"
        try:
            more = f";language={language}" + ("" if tolerance_um is None else f";tolerance={tolerance_um:g}")
            return self._asked(machine, selector + more, ReportPage, _REPORT_LIMIT_S)
        except QueryRefusal:  # an earlier program knows neither; what else is wrong is refused again
            return self._asked(machine, selector, ReportPage, _REPORT_LIMIT_S)

    def ask_scenario(self, machine: str, load: str, minutes: int) -> ScenarioPage:
        """A machine's errors if a load runs for some minutes. Blocks. Raises OSError likewise."""
        return self._asked(machine, f"{keys.SCENARIO}?load={load};minutes={minutes}", ScenarioPage, _ANSWER_LIMIT_S)

    def _asked(self, machine: str, selector: str, answer: type[_Answer], limit_s: float) -> _Answer:
        try:
            return ask(
                self._hearing.at(machine)[0], f"{keys.root(self._site.prefix, machine)}/{selector}", answer, limit_s
            )
        except ValueError as error:
            raise OSError(str(error)) from error

    def give(self, machine: str, by: CommandSigner, name: CommandName) -> CommandAnswer:
        """Give a machine's gateway a command. Blocks. Raises as `gateway.telemetry.asking.command`."""
        return command(self._hearing.at(machine), keys.root(self._site.prefix, machine), by, name, COMMAND_LIMIT_S)

    def _life(self, key: str, alive: bool) -> bool:
        self._site.life(key, alive=alive)
        return True
