"""Feed what was stored to a fresh controller: to prove the decisions, or to go on where an earlier run ended."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from gateway.config import GatewayConfig
from gateway.config.model import validate
from gateway.control.sensor_watch import SeenBefore
from gateway.control.trainer import has_failed
from gateway.service import Past
from gateway.storage import History, StoredStep, StoreError
from talc.control import Controller
from talc.frame import Decision, Event, EventKind, TrainingJob
from talc.names import THERMAL_ERRORS
from talc.training import train

_ARRAYS = ("predicted", "corrected", "sigma", "limits")


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a replay and the record part."""

    k: int
    what: str


@dataclass(slots=True)
class ReplayResult:
    """What a replay found."""

    steps: int = 0
    trainings: int = 0
    differences: int = 0
    first: Difference | None = None

    @property
    def identical(self) -> bool:
        """Whether every decision and every model was the same, bit for bit."""
        return self.steps > 0 and self.differences == 0


def stored_config(history: History) -> GatewayConfig:
    """The configuration of the latest run. StoreError: the database is empty."""
    found = history.config()
    if found is None:
        raise StoreError("the database holds no run yet")
    return validate(found[0])


def replay(history: History, progress: Callable[[int], None] = lambda _: None) -> ReplayResult:
    """Every frame through a fresh controller, every training done again; compares all of it with the record."""
    config = stored_config(history)
    controller = Controller(config.input_names, config.talc)
    result, job = ReplayResult(), None
    for step in history.steps():
        decision = controller.step(step.frame)
        result.steps += 1
        for what in _differences(decision, step):
            _note(result, step.frame.k, what)
        job = decision.training or job
        for stored in step.adopted:
            models = stored
            if has_failed(stored):  # of the computer, not of the data: nothing to repeat
                job = None
            elif job is None:
                _note(result, step.frame.k, "models were adopted that no training was wanted for")
            else:
                models, job = train(job), None
                result.trainings += 1
                if models.fingerprint() != stored.fingerprint():
                    _note(result, step.frame.k, "the training gave other models")
            controller.adopt(models)
        progress(result.steps)
    return result


def past_of(history: History, config: GatewayConfig) -> Past:
    """The controller as an earlier run left it, rebuilt from the record with the stored models.

    A fresh start when the record is empty or was made with other inputs or other TALC settings.
    """
    fresh = Past(Controller(config.input_names, config.talc))
    if history.config() is None:
        return fresh
    before = stored_config(history)
    if before.input_names != config.input_names or before.talc != config.talc:
        raise StoreError(
            "the record was made with other inputs or [talc] settings; give [storage] another path to start anew"
        )
    controller = fresh.controller
    last: Decision | None = None
    job: TrainingJob | None = None
    missing: dict[str, int] = {}
    measured: list[int | None] = [None] * len(THERMAL_ERRORS)
    for step in history.steps():
        last = controller.step(step.frame)
        missing = {name: missing.get(name, step.frame.k) for name in last.substituted}
        job = last.training or job
        if step.frame.measurement is not None:
            found = np.isfinite(step.frame.measurement.errors)
            measured = [step.frame.k if new else k for new, k in zip(found, measured, strict=True)]
        for stored in step.adopted:
            controller.adopt(stored)
            job = None
    cycles = history.measurements()
    first = next((m for m in cycles if m.errors is not None and m.centres_mm is not None), None)
    return Past(
        controller,
        last_k=None if last is None else last.k,
        pending=(job, None if last is None else last.measure),
        reference_mm=None if first is None or first.centres_mm is None else first.centres_mm + first.in_force_um * 1e-3,
        last_number=history.last_number(),
        missing=missing,
        measured=tuple(measured),
        seen=_seen(controller, history.events()),
    )


def _seen(controller: Controller, events: Sequence[tuple[datetime, int | None, Event]]) -> SeenBefore | None:
    """What the sensor check may go on from."""
    state, since = controller.state(), None
    for _, k, event in events:
        match event.kind:
            case EventKind.SENSOR_SUSPECT:
                since = k if since is None else since
            case EventKind.SENSORS_AGREE:
                since = None
            case _:
                pass
    if state.last_k is None:
        return None
    return SeenBefore(state.last_k + 1 - len(state.inputs), state.inputs, state.valid, since)


def _differences(decision: Decision, step: StoredStep) -> Iterator[str]:
    stored = step.decision
    for name in _ARRAYS:
        if not np.array_equal(getattr(decision, name), getattr(stored, name), equal_nan=True):
            yield f"{name}: {getattr(decision, name)} instead of {getattr(stored, name)}"
    for name in ("phase", "measure", "events"):
        if getattr(decision, name) != getattr(stored, name):
            yield f"{name}: {getattr(decision, name)} instead of {getattr(stored, name)}"
    wanted = decision.training.why.value if decision.training else None
    if wanted != step.training_wanted:
        yield f"training wanted: {wanted} instead of {step.training_wanted}"


def _note(result: ReplayResult, k: int, what: str) -> None:
    result.differences += 1
    if result.first is None:
        result.first = Difference(k, what)
