"""The grid loop: once per step it makes a frame, lets the controller decide, and carries out the decision."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping

from gateway.ages import Ages, StepTime
from gateway.clock import ServiceClock
from gateway.config import Probing
from gateway.control.grid import GridSampler, Instant, Schedule
from gateway.control.trainer import models_of_failure, train_apart
from gateway.events import (
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ReasonsGiven,
    Sink,
)
from gateway.nc import NcLink
from gateway.polling import Periodic
from gateway.probing import Bulletin, End, Outcome, Outlook, ProbingSchedule, Standing
from talc.control import Controller
from talc.frame import Event, EventKind, FloatArray, Frame, Measurement, TrainingJob, Why
from talc.learner import ForecastRecord
from talc.models import ModelSet

log = logging.getLogger(__name__)

_EXPLAIN_EVERY_S = 3599.0
"""An hour, less what the ends of its steps may differ by."""
_AHEAD_S = (1800.0, 3600.0, 7200.0, 10800.0, 14400.0, 21600.0, 28800.0)
"""How far the forecasts reach."""


class GridLoop:
    """Drives the pure controller on the grid.

    Parameters
    ----------
    controller: fresh, or rebuilt from the store
    sampler, schedule: the grid
    link: the NC; None when the gateway runs without one
    plan: when to request a measurement
    probing: `lead_s` and `poll_s` are used
    sink: receives frames, decisions, measurements, models and events
    pending: a training and a measurement that an earlier run still wanted
    ages: how long ago the last stored frame was; None: there is none
    train: runs a training
    seen: called with every frame, after everything that follows from it
    planned: by planned load, how the inputs (steps, n) will differ from the last frame's at each of so many steps;
        None: unknown
    """

    def __init__(
        self,
        controller: Controller,
        sampler: GridSampler,
        schedule: Schedule,
        clock: ServiceClock,
        link: NcLink | None,
        plan: ProbingSchedule,
        probing: Probing,
        sink: Sink,
        pending: tuple[TrainingJob | None, Why | None] = (None, None),
        ages: Ages | None = None,
        train: Callable[[TrainingJob], Awaitable[ModelSet]] = train_apart,
        seen: Callable[[Frame], None] = lambda _: None,
        planned: Callable[[int], Mapping[str, FloatArray | None]] = lambda _: {},
    ) -> None:
        self._controller, self._sampler, self._schedule, self._clock = controller, sampler, schedule, clock
        self._link, self._plan, self._probing = link, plan, probing
        self._sink = sink
        self._ages = ages or Ages(clock, 1.0, None)
        self._job, wanted = pending
        self._plan.want(wanted, clock.monotonic())
        self._run_training, self._seen, self._planned = train, seen, planned
        self._bulletin, self._outlook = Bulletin(), Outlook(Standing.NOT_WANTED, None)
        ahead = {max(1, round(ahead_s / schedule.step_s)) for ahead_s in _AHEAD_S}
        self._forecasts = ForecastRecord(tuple(sorted(ahead)), schedule.step_s)
        self._finished: Measurement | None = None
        self._measuring: asyncio.Task[None] | None = None
        self._training: asyncio.Task[None] | None = None
        self._last_k = -1
        self._present: tuple[asyncio.TaskGroup, Instant] | None = None
        """Tasks and end of the present step; None: it does not run."""
        self._explain_s = -math.inf
        """When the reasons are due, if no measurement comes before."""

    async def run(self) -> None:
        """Run until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                while True:
                    instant = self._schedule.next(self._clock.utc(), self._clock.monotonic(), known=self._ages.known)
                    if instant.clock_moved_s:
                        log.warning("the clock was set by %+.0f s; the grid follows", instant.clock_moved_s)
                    self._present = tasks, instant
                    self._begin_what_is_wanted(tasks, instant)
                    await self._clock.sleep_until(instant.monotonic_s)
                    if self._last_k < 0 and self._schedule.moved(self._clock.utc(), self._clock.monotonic()):
                        continue  # the clock was set after the start: a run's first frame says how long the pause was
                    with self._clock.hold():
                        self._step(instant)
                        # Let the other tasks of this instant start while time still stands still.
                        await asyncio.sleep(0)
        finally:
            self._present = None

    def measure_now(self) -> Outlook:
        """A person wants a measurement, so that this step contains its result if there is time for it.

        Returns how it stands.
        """
        self._plan.order(self._clock.monotonic())
        if self._present is not None:
            self._begin_what_is_wanted(*self._present)
        outlook = self._plan.look(None if self._link is None else self._link.present, self._clock.monotonic())
        self._tell(outlook)
        return outlook

    def _begin_what_is_wanted(self, tasks: asyncio.TaskGroup, instant: Instant) -> None:
        if self._job is not None and (self._training is None or self._training.done()):
            job, self._job = self._job, None
            self._training = tasks.create_task(self._train(job), name="training")
        if (
            self._plan.wanted
            and self._link is not None
            and self._link.may_probe
            and (self._measuring is None or self._measuring.done())
            and self._finished is None
        ):
            at = max(self._clock.monotonic(), instant.monotonic_s - self._probing.lead_s)
            self._measuring = tasks.create_task(self._measure(self._link, at), name="measurement")

    def _step(self, instant: Instant) -> None:
        measurement, self._finished = self._finished, None
        unknown = self._last_k < 0 and math.isinf(self._ages.pause_s)
        frame = self._sampler.frame(instant, measurement, pause_unknown=unknown)
        decision = self._controller.step(frame)
        self._last_k = frame.k
        self._sink(FrameMade(frame, self._moment(instant)))
        self._sink(DecisionMade(decision))
        for event in decision.events:
            self._sink(EventReported(event, decision.k))
        self._plan.want(decision.measure, self._clock.monotonic())
        if decision.training is not None:
            self._job = decision.training
        if self._link is not None:
            self._link.follow(decision)
        self._seen(frame)
        if measurement is not None or instant.monotonic_s >= self._explain_s:
            self._explain(instant.monotonic_s)
        if (forecast := self._controller.forecast(self._forecasts.steps)) is not None:
            measured = measurement is not None
            misses = self._forecasts.take(forecast, decision.corrected, decision.sigma, measured=measured)
            steps = self._forecasts.steps
            planned = {
                name: None if changes is None else self._controller.along(changes, steps)
                for name, changes in self._planned(steps[-1]).items()
            }
            self._sink(ForecastMade(forecast, misses, planned))

    def _moment(self, instant: Instant) -> StepTime:
        return StepTime(instant.k, self._clock.origin(), instant.monotonic_s, instant.lead_s, instant.known)

    def _explain(self, now_s: float) -> None:
        self._explain_s = now_s + _EXPLAIN_EVERY_S
        if (reasons := self._controller.reasons()) is not None:
            self._sink(ReasonsGiven(reasons))

    async def _measure(self, link: NcLink, at_s: float) -> None:
        """Handle one wanted measurement: wait for the right moment, request it, pass on the result."""
        polls = Periodic(self._clock, self._probing.poll_s, first_s=at_s)
        while True:
            await polls.wait()
            if not link.tried:  # a run begins with a measurement that an earlier one wanted
                polls.done()
                continue
            outlook = self._plan.look(link.present, self._clock.monotonic())
            self._tell(outlook)
            if outlook.standing is Standing.DUE:
                break
            if not self._plan.wanted:
                self._tell(self._plan.look(link.present, self._clock.monotonic()))
                return
            polls.done()
        why = self._plan.asked()
        self._tell(self._plan.look(link.present, self._clock.monotonic()))
        outcome: Outcome = await link.measure(why)
        self._sink(MeasurementEnded(outcome))
        if outcome.end is End.REJECTED:
            log.warning("measurement rejected: %s", outcome.reason)
            self._sink(EventReported(Event(EventKind.MEASUREMENT_REJECTED, outcome.reason), self._last_k))
        self._finished = outcome.measurement
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
            self._sink(EventReported(event, self._last_k))

    async def _train(self, job: TrainingJob) -> None:
        # A training takes seconds; on a real machine that is less than a grid step.
        with self._clock.hold():
            try:
                models = await self._run_training(job)
            except Exception as error:
                log.exception("the training of step %d failed", job.k)
                models = models_of_failure(job, error)
            events = self._controller.adopt(models)
        self._sink(ModelsAdopted(models, self._last_k))
        for event in events:
            self._sink(EventReported(event, self._last_k))
