"""The state of an earlier run that a restart needs, rebuilt from the store."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from gateway.config import GatewayConfig, parse_prior, validate
from gateway.control import SeenBefore
from gateway.storage import History, Store, StoredStep, StoreError
from talc.control import Controller
from talc.frame import Decision, Event, EventKind, FloatArray, TrainingJob, Why
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings

_FIRST_METHOD = "models"
"""The method of programs that stored no `[talc] method`: they had no other."""


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

    former_method: str | None = None
    """`[talc] method` of the latest run, if this configuration has another one."""
    other_prior: bool = False
    """Whether the latest run had another prior, or only one of the two has one."""


def stored_config(history: History) -> GatewayConfig:
    """The configuration of the latest run. Raises StoreError if the database is empty."""
    found = history.config()
    if found is None:
        raise StoreError("the database holds no run yet")
    return from_stored(found[0], history.prior())


def from_stored(text: str, prior: str | None = None) -> GatewayConfig:
    """The configuration and the prior in a stored text, as the program that stored it understood them."""
    data = json.loads(text)
    config = validate({**data, "talc": {"method": _FIRST_METHOD, **data.get("talc", {})}})
    return config if prior is None else config.with_prior(parse_prior(prior))


def controller_of(config: GatewayConfig) -> Controller:
    """A fresh controller of a configuration."""
    prior = None if config.prior is None else config.prior.prior
    return Controller(config.input_names, config.talc, config.grid.step_s, prior)


def decide_alike(one: GatewayConfig, other: GatewayConfig) -> bool:
    """Whether controllers with these settings decide alike for the same inputs; unused settings do not count."""
    return _settings_alike(one.talc, other.talc) and (one.talc.method != "learner" or one.prior == other.prior)


def _settings_alike(one: TalcSettings, other: TalcSettings) -> bool:
    return one.method == other.method and _used(one) == _used(other)


def _used(talc: TalcSettings) -> object:
    return talc.learner if talc.method == "learner" else (talc.control, talc.training)


@dataclass(slots=True)
class Rebuilt:
    """A controller after stored steps, and what it was then waiting for."""

    controller: Controller
    last: Decision | None = None
    job: TrainingJob | None = None
    """A training that was wanted and has not ended."""
    missing: dict[str, int] = field(default_factory=dict)
    measured: list[int | None] = field(default_factory=lambda: [None] * len(THERMAL_ERRORS))


def rebuilt(steps: Iterable[StoredStep], config: GatewayConfig) -> Rebuilt:
    """The controller of a configuration, after the stored frames and models. A learner takes only the frames."""
    controller = controller_of(config)
    found = Rebuilt(controller)
    for step in steps:
        last = found.last = controller.step(step.frame)
        found.missing = {name: found.missing.get(name, step.frame.k) for name in last.substituted}
        found.job = last.training or found.job
        if step.frame.measurement is not None:
            new = np.isfinite(step.frame.measurement.errors)
            found.measured = [step.frame.k if n else k for n, k in zip(new, found.measured, strict=True)]
        for stored in () if config.talc.method == "learner" else step.adopted:
            controller.adopt(stored)
            found.job = None
    return found


def past_in(store: Store, config: GatewayConfig) -> Past:
    """`past_of` what a store holds. A damaged one is set aside first, and what can be read of it counts.

    Raises StoreError as `past_of`, or when the damaged one cannot be set aside.
    """
    try:
        with store.same_file() as file, History(config.storage.path) as history:
            return past_of(history, config)
    except StoreError:
        raise
    except Exception as error:  # noqa: BLE001 - anything comes of a damaged row; of a whole database it is raised again
        store.repair(error, file)
    with store.same_file(), History(config.storage.path) as history:
        return past_of(history, config)


def past_of(history: History, config: GatewayConfig) -> Past:
    """The controller as an earlier run left it, rebuilt from the record with the stored models.

    A fresh start if the record is empty. If the latest run used another method or prior, the controller is as if the
    present one had been used from the beginning of the record.

    Raises StoreError when the record was made with other inputs or other settings of the same method.
    """
    if history.config() is None:
        return Past(rebuilt((), config).controller)
    before = stored_config(history)
    changed = before.talc.method != config.talc.method
    if before.input_names != config.input_names or not (changed or _settings_alike(before.talc, config.talc)):
        raise StoreError(
            "the record was made with other inputs or [talc] settings; give [storage] another path to start again"
        )
    found = rebuilt(history.steps(), config)
    cycles = history.measurements()
    first = next((m for m in cycles if m.errors is not None and m.centres_mm is not None), None)
    return Past(
        found.controller,
        last_k=None if found.last is None else found.last.k,
        pending=(found.job, None if found.last is None else found.last.measure),
        reference_mm=None if first is None or first.centres_mm is None else first.centres_mm + first.in_force_um * 1e-3,
        last_number=history.last_number(),
        missing=found.missing,
        measured=tuple(found.measured),
        seen=_seen(found.controller, history.events()),
        former_method=before.talc.method if changed else None,
        other_prior=not changed and config.talc.method == "learner" and before.prior != config.prior,
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
