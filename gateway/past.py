"""The state of an earlier run that a restart needs, rebuilt from the store."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from gateway.config import GatewayConfig
from gateway.config.model import validate
from gateway.control.sensor_watch import SeenBefore
from gateway.storage import History, StoreError
from talc.control import Controller
from talc.frame import Decision, Event, EventKind, FloatArray, TrainingJob, Why
from talc.names import THERMAL_ERRORS


@dataclass(frozen=True, slots=True)
class Past:
    """What an earlier run left in the store."""

    controller: Controller
    last_k: int | None = None
    pending: tuple[TrainingJob | None, Why | None] = (None, None)
    reference_mm: FloatArray | None = None
    last_number: int | None = None
    missing: Mapping[str, int] = field(default_factory=dict)
    """Inputs of live models without a good value at the last step, and the grid index since when."""
    measured: tuple[int | None, ...] = (None,) * len(THERMAL_ERRORS)
    """Grid index of each error's last measurement."""
    seen: SeenBefore | None = None


def stored_config(history: History) -> GatewayConfig:
    """The configuration of the latest run. StoreError: the database is empty."""
    found = history.config()
    if found is None:
        raise StoreError("the database holds no run yet")
    return validate(found[0])


def past_of(history: History, config: GatewayConfig) -> Past:
    """The controller as an earlier run left it, rebuilt from the record with the stored models.

    A fresh start when the record is empty or was made with other inputs or other TALC settings.
    """
    fresh = Past(Controller(config.input_names, config.talc, config.grid.step_s))
    if history.config() is None:
        return fresh
    before = stored_config(history)
    if before.input_names != config.input_names or before.talc != config.talc:
        raise StoreError(
            "the record was made with other inputs or [talc] settings; give [storage] another path to start again"
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
    """What the sensor check may continue from."""
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
