"""Handles a wanted measurement: waits for the right moment, requests it from the NC, and keeps its result."""

import asyncio
import logging

from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, MeasurementEnded, OutlookChanged, Sink
from gateway.model.probing import End, Outcome, Outlook
from gateway.model.standing import Standing
from gateway.model.text import Text
from gateway.model.wording import event_of
from gateway.nc.link import NcLink
from gateway.nc.probing.schedule import Bulletin, ProbingSchedule, excess
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from talc.frame import Decision, EventKind, Why

log = logging.getLogger(__name__)


class Measuring:
    """One measurement at a time.

    Parameters
    ----------
    link: the NC; None when the gateway runs without one
    plan: when to request a measurement
    probing: `lead_s` and `poll_s` are used
    sink: receives outlooks, outcomes and events
    wanted: what an earlier run still wanted
    anew: whether it wanted a new reference
    """

    def __init__(
        self,
        link: NcLink | None,
        plan: ProbingSchedule,
        probing: Probing,
        clock: ServiceClock,
        sink: Sink,
        wanted: Why | None = None,
        *,
        anew: bool = False,
    ) -> None:
        self._link, self._plan, self._probing, self._clock, self._sink = link, plan, probing, clock, sink
        self._plan.want(wanted, clock.monotonic())
        if anew:
            self._plan.renew(clock.monotonic())
        self._bulletin, self._outlook = Bulletin(), Outlook(Standing.NOT_WANTED, None)
        self._task: asyncio.Task[None] | None = None
        self._finished: Outcome | None = None
        """One with a measurement that no frame has yet."""
        self._k = -1
        self._present: tuple[asyncio.TaskGroup, float] | None = None
        """Tasks and end of the present step; None: none has begun."""

    def want(self, decision: Decision) -> None:
        """What the controller decided."""
        self._k = decision.k
        self._plan.want(decision.measure, self._clock.monotonic(), excess(decision))

    def begin(self, tasks: asyncio.TaskGroup, end_s: float) -> None:
        """A step begins, which lasts until `end_s`: handle what is wanted, so that its result comes before that."""
        self._present = tasks, end_s
        if (
            self._plan.wanted
            and self._link is not None
            and self._link.may_probe
            and (self._task is None or self._task.done())
            and self._finished is None
        ):
            at = max(self._clock.monotonic(), end_s - self._probing.lead_s)
            self._task = tasks.create_task(self._measure(self._link, at), name="measurement")

    def end(self) -> None:
        """No step runs from now on."""
        self._present = None

    def order(self) -> Outlook:
        """A person wants a measurement, so that this step contains its result if there is time for it.

        Returns how it stands.
        """
        self._plan.order(self._clock.monotonic())
        if self._present is not None:
            self.begin(*self._present)
        outlook = self._look(self._link)
        self._tell(outlook)
        return outlook

    def renew_reference(self, by: str) -> bool:
        """A person wants a new reference: what was measured and is in no frame yet counts no more. The new one is
        measured as soon as no program runs.

        Returns whether there was one to drop.
        """
        if self._link is None:
            return False
        dropped = self._link.drop_reference(Text(NoticeCode.REFERENCE_DROPPED, by=by))
        if dropped is None:
            return False
        self._finished = None
        self._plan.renew(self._clock.monotonic())
        self._sink(MeasurementEnded(dropped))
        if self._present is not None:
            self.begin(*self._present)
        self._tell(self._look(self._link))
        return True

    def _look(self, link: NcLink | None) -> Outlook:
        now_s = self._clock.monotonic()
        return self._plan.look(None, now_s) if link is None else self._plan.look(link.present, now_s, link.barrier)

    def take(self) -> Outcome | None:
        """The outcome with a measurement that has not been taken yet."""
        finished, self._finished = self._finished, None
        return finished

    async def _measure(self, link: NcLink, at_s: float) -> None:
        polls = Periodic(self._clock, self._probing.poll_s, first_s=at_s)
        while True:
            await polls.wait()
            if not link.tried:  # a run begins with a measurement that an earlier one wanted
                polls.done()
                continue
            outlook = self._look(link)
            self._tell(outlook)
            if outlook.standing is Standing.DUE:
                break
            if not self._plan.wanted:
                self._tell(self._look(link))
                return
            polls.done()
        why = self._plan.asked()
        self._tell(self._look(link))
        outcome: Outcome = await link.measure(why)
        self._sink(MeasurementEnded(outcome))
        if outcome.end is End.REJECTED:
            log.warning("%s", Text(NoticeCode.MEASUREMENT_NOT_TAKEN, why=outcome.reason))
            self._sink(EventReported(event_of(EventKind.MEASUREMENT_REJECTED, outcome.reason), self._k))
        self._finished = None if outcome.measurement is None else outcome
        self._tell(self._plan.ended(outcome.end, outcome.reason, self._clock.monotonic()))

    def _tell(self, outlook: Outlook) -> None:
        """Publish what changed; log each reason once while it lasts."""
        if outlook == self._outlook:
            return
        if outlook.standing is Standing.WAITING and outlook.reason != self._outlook.reason:
            log.info("a measurement (%s) %s", outlook.why, outlook.reason)
        self._outlook = outlook
        self._sink(OutlookChanged(outlook))
        for event in self._bulletin.of(outlook):
            log.warning("%s", event.text)
            self._sink(EventReported(event, self._k))
