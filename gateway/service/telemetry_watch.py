"""Reports how the telemetry is connected: whenever that changes, since when, to whom, or why not."""

import logging
from collections.abc import Callable

from gateway.model.codes import NoticeCode
from gateway.model.connection import Connection
from gateway.model.notice import Notice, Notify
from gateway.model.text import Text
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

_PERIOD_S = 10.0
SUBJECT = "telemetry"
ECHO, NAME = "telemetry at the router", "name of the machine"


class TelemetryWatch:
    """Looks every 10 s at what the session's own thread has found.

    Parameters
    ----------
    machine: its name
    connection: as it is; None: the telemetry is off
    notify: called at the problem's begin and end, and when it is connected for the first time
    """

    def __init__(
        self, machine: str, connection: Callable[[], Connection | None], clock: ServiceClock, notify: Notify
    ) -> None:
        self._machine, self._connection, self._clock, self._notify = machine, connection, clock, notify
        self._problems = Problems(clock, _PERIOD_S, notify, log)
        self._told = False

    async def run(self) -> None:
        """Run until cancelled."""
        await Periodic(self._clock, _PERIOD_S).run(self._look)

    async def _look(self, _: float) -> None:
        found = self._connection()
        if found is None:
            return
        self._tell_connection(found)
        if found.confirmed is False:
            text = Text(NoticeCode.TELEMETRY_UNCONFIRMED, to=found.to, machine=self._machine)
            self._problems.report(ECHO, text)
        elif found.confirmed:
            self._problems.clear(ECHO, NoticeCode.TELEMETRY_CONFIRMED, to=found.to)
        if found.other:
            text = Text(NoticeCode.TWO_OF_ONE_NAME, machine=self._machine, other=found.other)
            self._problems.report(NAME, text)
        elif found.confirmed:
            self._problems.clear(NAME, NoticeCode.ONE_OF_THIS_NAME, machine=self._machine)

    def _tell_connection(self, found: Connection) -> None:
        if found.problem:
            self._problems.report(SUBJECT, found.problem, found.kind)
            self._told = True
        elif self._told:
            self._problems.clear(SUBJECT, NoticeCode.TELEMETRY_BACK, to=found.to)
        elif found.to:
            self._told = True
            text = Text(NoticeCode.TELEMETRY_BACK, to=found.to)
            log.info("%s", text)
            self._notify(Notice(SUBJECT, text, ended=True, at_s=self._clock.monotonic()))
