"""The grid loop: once per step it makes a frame, lets the controller decide, and carries out the decision."""

import asyncio
import logging
import math
from collections.abc import Callable, Sequence

from gateway.clock import Ages, ServiceClock, StepTime
from gateway.control.grid import GridSampler, Instant, Schedule
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings
from gateway.events import DecisionMade, EventReported, FrameMade, Sink
from talc.control import Controller
from talc.frame import Decision, Frame

log = logging.getLogger(__name__)


class GridLoop:
    """Drives the pure controller on the grid.

    Parameters
    ----------
    controller: fresh, or rebuilt from the store
    sampler, schedule: the grid
    sink: receives frames, decisions and events
    measuring, trainings: carry out what the controller wants
    ages: how long ago the last stored frame was; None: there is none
    followers: called with every frame and its decision, in this order
    """

    def __init__(
        self,
        controller: Controller,
        sampler: GridSampler,
        schedule: Schedule,
        clock: ServiceClock,
        sink: Sink,
        measuring: Measuring,
        trainings: Trainings,
        ages: Ages | None = None,
        followers: Sequence[Callable[[Frame, Decision], None]] = (),
    ) -> None:
        self._controller, self._sampler, self._schedule, self._clock = controller, sampler, schedule, clock
        self._sink, self._measuring, self._trainings = sink, measuring, trainings
        self._ages, self._followers = ages or Ages(clock, 1.0, None), tuple(followers)
        self._last_k = -1

    async def run(self) -> None:
        """Run until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                while True:
                    instant = self._schedule.next(self._clock.utc(), self._clock.monotonic(), known=self._ages.known)
                    if instant.clock_moved_s:
                        log.warning("the clock was set by %+.0f s; the grid follows", instant.clock_moved_s)
                    self._trainings.begin(tasks)
                    self._measuring.begin(tasks, instant.monotonic_s)
                    await self._clock.sleep_until(instant.monotonic_s)
                    if self._last_k < 0 and self._schedule.moved(self._clock.utc(), self._clock.monotonic()):
                        continue  # the clock was set after the start: a run's first frame says how long the pause was
                    with self._clock.hold():
                        self._step(instant)
                        # Let the other tasks of this instant start while time still stands still.
                        await asyncio.sleep(0)
        finally:
            self._measuring.end()

    def _step(self, instant: Instant) -> None:
        unknown = self._last_k < 0 and math.isinf(self._ages.pause_s)
        frame = self._sampler.frame(instant, self._measuring.take(), pause_unknown=unknown)
        decision = self._controller.step(frame)
        self._last_k = frame.k
        self._sink(FrameMade(frame, self._moment(instant)))
        self._sink(DecisionMade(decision))
        for event in decision.events:
            self._sink(EventReported(event, decision.k))
        self._measuring.want(decision.measure, frame.k)
        self._trainings.want(decision.training, frame.k)
        for follow in self._followers:
            follow(frame, decision)

    def _moment(self, instant: Instant) -> StepTime:
        return StepTime(instant.k, self._clock.origin(), instant.monotonic_s, instant.lead_s, instant.known)
