"""Feeds stored data to a fresh controller and compares its decisions and models with the record, bit for bit."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from gateway.control.restart.earlier import decide_alike
from gateway.control.restart.rebuild import rebuilt, start_of
from gateway.storage.configurations import from_stored, stored_config
from gateway.storage.history import History
from gateway.storage.stored import StoredStep
from talc.frame import Decision, Event
from talc.papers.training import train

_ARRAYS = ("predicted", "corrected", "sigma", "limits")


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a replay differs from the record."""

    k: int
    what: str


@dataclass(slots=True)
class ReplayResult:
    """The result of a replay."""

    steps: int = 0
    trainings: int = 0
    differences: int = 0
    first: Difference | None = None

    @property
    def identical(self) -> bool:
        """Whether every decision and every model was the same, bit for bit."""
        return self.steps > 0 and self.differences == 0


def replay(history: History, progress: Callable[[int], None] = lambda _: None) -> ReplayResult:
    """Run every frame through a fresh controller and repeat every training; compares everything with the record.

    Where a restart changed the inputs, the settings, the method or the prior, the controller is rebuilt as that restart
    did. Priors are taken from the database, whatever has happened to their files.
    """
    runs = [(k, from_stored(text, prior)) for k, text, prior in history.runs()] or [(0, stored_config(history))]
    _, config = runs.pop(0)
    start = start_of(config, history)
    controller, result, job = start.controller, ReplayResult(), None
    for step in history.steps(start.after_k):
        while runs and runs[0][0] <= step.frame.k:
            (first_k, after), before = runs.pop(0), config
            config = after
            if not decide_alike(before, after):
                earlier = takewhile(_before(first_k), history.steps(start.after_k, after.input_names))
                restarted = rebuilt(earlier, after, start_of(after, history))
                controller, job = restarted.controller, restarted.job
        decision = controller.step(step.frame)
        result.steps += 1
        for what in _differences(decision, step):
            _note(result, step.frame.k, what)
        job = decision.training or job
        for stored in step.adopted:
            models = stored
            if stored.failed:  # the computer failed, not the data: nothing to repeat
                job = None
            elif job is None:
                _note(result, step.frame.k, "models were adopted although no training was wanted")
            else:
                models, job = train(job), None
                result.trainings += 1
                if replace(models, notes=()).fingerprint() != replace(stored, notes=()).fingerprint():
                    _note(result, step.frame.k, "the training gave other models")
            controller.adopt(models)
        progress(result.steps)
    return result


def _before(k: int) -> Callable[[StoredStep], bool]:
    return lambda step: step.frame.k < k


def _differences(decision: Decision, step: StoredStep) -> Iterator[str]:
    stored = step.decision
    for name in _ARRAYS:
        if not np.array_equal(getattr(decision, name), getattr(stored, name), equal_nan=True):
            yield f"{name}: {getattr(decision, name)} instead of {getattr(stored, name)}"
    if step.trust_known and not np.array_equal(decision.trusted, stored.trusted):
        yield f"trusted: {decision.trusted} instead of {stored.trusted}"
    for name in ("phase", "measure"):
        if getattr(decision, name) != getattr(stored, name):
            yield f"{name}: {getattr(decision, name)} instead of {getattr(stored, name)}"
    if [_told(e) for e in decision.events] != [_told(e) for e in stored.events]:
        yield f"events: {decision.events} instead of {stored.events}"
    wanted = decision.training.why.value if decision.training else None
    if wanted != step.training_wanted:
        yield f"training wanted: {wanted} instead of {step.training_wanted}"


def _told(event: Event) -> tuple[object, ...]:
    """What an event tells besides its wording."""
    return event.kind, event.error, event.value, event.limit


def _note(result: ReplayResult, k: int, what: str) -> None:
    result.differences += 1
    if result.first is None:
        result.first = Difference(k, what)
