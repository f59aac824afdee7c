"""Runs trainings in a separate process, and returns an empty model set for one that failed."""

import asyncio
import logging
from collections.abc import Awaitable, Callable

from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, ModelsAdopted, Sink
from gateway.model.text import failure
from gateway.model.wording import worded
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.workers.process import in_process
from talc.control import Controller
from talc.frame import TrainingJob
from talc.models import ModelSet, TrainingNote
from talc.names import THERMAL_ERRORS
from talc.papers.training import train

log = logging.getLogger(__name__)


async def train_apart(job: TrainingJob) -> ModelSet:
    """The models of a job, trained in a separate process. Raises WorkError."""
    return await in_process(train, job)


def models_of_failure(job: TrainingJob, error: Exception) -> ModelSet:
    """An empty model set, adopted instead of a failed training's models: the former ones stay."""
    note = TrainingNote(NoticeCode.TRAINING_FAILED, {"error": failure(error)})
    nothing = (None,) * len(THERMAL_ERRORS)
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=nothing, notes=(note,), failed=True)


class Trainings:
    """One training at a time; the last one wanted follows it.

    Parameters
    ----------
    controller: adopts the models
    sink: receives models and events
    job: what an earlier run still wanted
    run: runs a training
    """

    def __init__(
        self,
        controller: Controller,
        clock: ServiceClock,
        sink: Sink,
        job: TrainingJob | None = None,
        run: Callable[[TrainingJob], Awaitable[ModelSet]] = train_apart,
    ) -> None:
        self._controller, self._clock, self._sink, self._job, self._run = controller, clock, sink, job, run
        self._task: asyncio.Task[None] | None = None
        self._k = -1

    def want(self, job: TrainingJob | None, k: int) -> None:
        """What the controller decided at step `k`; None: nothing new."""
        self._k = k
        if job is not None:
            self._job = job

    def begin(self, tasks: asyncio.TaskGroup) -> None:
        """A step begins: start the training that is wanted, unless one runs."""
        if self._job is not None and (self._task is None or self._task.done()):
            job, self._job = self._job, None
            self._task = tasks.create_task(self._train(job), name="training")

    async def _train(self, job: TrainingJob) -> None:
        # A training takes seconds; on a real machine that is less than a grid step.
        with self._clock.hold():
            try:
                models = await self._run(job)
            except Exception as error:
                log.exception("the training of step %d failed", job.k)
                models = models_of_failure(job, error)
            events = self._controller.adopt(models)
        self._sink(ModelsAdopted(models, self._k))
        for event in events:
            self._sink(EventReported(worded(event), self._k))
