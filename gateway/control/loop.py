"""The grid loop, which makes a frame once per step, lets the controller decide, and carries out the decision.

Between two steps the correction follows the inputs.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Sequence
from typing import Protocol

from gateway.control.grid import GridSampler, Instant, Schedule
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings
from gateway.model.codes import NoticeCode
from gateway.model.events import DecisionMade, EventReported, FrameMade, Sink
from gateway.model.step_time import StepTime
from gateway.model.text import Text
from gateway.model.wording import worded
from gateway.runtime.ages import Ages
from gateway.runtime.clocks import ServiceClock
from talc.control import Controller
from talc.frame import Decision, FloatArray, Frame, Why

log = logging.getLogger(__name__)

_PARTS = 10
"""Parts of a step; after each of them the correction is renewed."""


class Compensating(Protocol):
    """What corrects the machine, such as an NcLink."""

    def follow(self, decision: Decision) -> None:
        """Compensate by this decision from now on."""
        ...

    def renew(self, corrected: FloatArray) -> None:
        """Compensate by these (9,) errors until the next decision, or until they are renewed again."""
        ...


class GridLoop:
    """Drives the pure controller on the grid.

    Parameters
    ----------
    controller: fresh, or rebuilt from the store
    sampler, schedule: the grid
    sink: receives frames, decisions and events
    measuring, trainings: carry out what the controller wants
    ages: how long ago the last stored frame was; None: there is none
    link: compensates by what is decided; None: nothing does
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
        link: Compensating | None = None,
        followers: Sequence[Callable[[Frame, Decision], None]] = (),
    ) -> None:
        self._controller, self._sampler, self._schedule, self._clock = controller, sampler, schedule, clock
        self._sink, self._measuring, self._trainings = sink, measuring, trainings
        self._ages, self._followers = ages or Ages(clock, 1.0, None), tuple(followers)
        self._link = link
        self._last_k, self._stepped_s = -1, 0.0

    async def run(self) -> None:
        """Run until cancelled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                while True:
                    instant = self._schedule.next(self._clock.utc(), self._clock.monotonic(), known=self._ages.known)
                    if instant.clock_moved_s:
                        log.warning("%s", Text(NoticeCode.CLOCK_SET, by_s=instant.clock_moved_s))
                    self._trainings.begin(tasks)
                    self._measuring.begin(tasks, instant.monotonic_s)
                    await self._wait(instant.monotonic_s)
                    if self._last_k < 0 and self._schedule.moved(self._clock.utc(), self._clock.monotonic()):
                        continue  # the clock was set after the start: a run's first frame says how long the pause was
                    with self._clock.hold():
                        self._step(instant)
                        # Let the other tasks of this instant start while time still stands still.
                        await asyncio.sleep(0)
        finally:
            self._measuring.end()

    async def _wait(self, until_s: float) -> None:
        """Sleep until the step ends. On the way the correction follows the inputs, whose means lag behind."""
        part_s = self._schedule.step_s / _PARTS
        for left in range(_PARTS - 1, 0, -1):
            due_s = until_s - left * part_s
            if due_s > self._clock.monotonic():
                await self._clock.sleep_until(due_s)
                with self._clock.hold():
                    self._follow_inputs(due_s)
        await self._clock.sleep_until(until_s)

    def _follow_inputs(self, now_s: float) -> None:
        inputs, valid = self._sampler.present(now_s)
        if self._last_k < 0 or now_s <= self._stepped_s:
            return
        corrected = self._controller.between(inputs, valid, (now_s - self._stepped_s) / self._schedule.step_s)
        if corrected is not None and self._link is not None:
            self._link.renew(corrected)

    def _step(self, instant: Instant) -> None:
        unknown = self._last_k < 0 and math.isinf(self._ages.pause_s)
        done = self._measuring.take()
        frame = self._sampler.frame(
            instant,
            None if done is None else done.measurement,
            pause_unknown=unknown,
            new_reference=done is not None and done.why is Why.REFERENCE,
        )
        decision = self._controller.step(frame)
        self._last_k, self._stepped_s = frame.k, instant.monotonic_s
        self._sink(FrameMade(frame, self._moment(instant)))
        self._sink(DecisionMade(decision))
        for event in decision.events:
            self._sink(EventReported(worded(event), decision.k))
        self._measuring.want(decision)
        self._trainings.want(decision.training, frame.k)
        if self._link is not None:
            self._link.follow(decision)
        for follow in self._followers:
            follow(frame, decision)

    def _moment(self, instant: Instant) -> StepTime:
        return StepTime(instant.k, self._clock.origin(), instant.monotonic_s, instant.lead_s, instant.known)
