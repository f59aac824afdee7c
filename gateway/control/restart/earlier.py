"""The state of an earlier run that a restart needs, rebuilt from the store."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field

from drivers.base import SetupError
from gateway.config.model import GatewayConfig
from gateway.control.planned_loads import rows_remembered
from gateway.control.restart.proven import is_elsewhere, paths_in, proven_in
from gateway.control.restart.rebuild import (
    Interrupted,
    RebuildProgress,
    Rebuilt,
    go_on,
    marks,
    rebuilt_from,
    start_of,
    used,
)
from gateway.control.sensor_watch import SeenBefore
from gateway.model.codes import NoticeCode
from gateway.model.commands import Disarmed, Pause
from gateway.model.step_time import StepTime
from gateway.model.text import Text
from gateway.storage.configurations import stored_config
from gateway.storage.faults import DamagedError, StoreError
from gateway.storage.history import History
from gateway.storage.store import Store
from gateway.storage.stored import StoredMeasurement
from talc.control import Controller
from talc.frame import FloatArray, TrainingJob, Why
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings

_SAVE_EVERY_STEPS = 20_000


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """What an earlier run left in the store."""

    controller: Controller
    last_k: int | None = None
    moment: StepTime | None = None
    """What the clocks said at the last step."""
    pauses: tuple[int, ...] = ()
    """First steps after pauses whose length the grid indices do not tell."""
    pending: tuple[TrainingJob | None, Why | None] = (None, None)
    reference_mm: FloatArray | None = None
    renewing: bool = False
    """Whether a new reference was asked for, or has become necessary, and is still to be measured."""
    last_number: int | None = None
    missing: Mapping[str, int] = field(default_factory=dict)
    """Inputs of live models without a good value at the last step, and the grid index since when."""
    measured: tuple[int | None, ...] = (None,) * len(THERMAL_ERRORS)
    """Grid index of each error's last measurement."""
    seen: SeenBefore | None = None
    since_snapshot: int = 0
    """Steps that the controller has taken since its last snapshot."""
    paused: Pause | None = None
    """The compensation's pause; None: it is not paused."""
    disarmed: Disarmed | None = None
    """Who has disarmed the gateway; None: nobody."""
    proven: bool = False
    """Whether a dry run went well, or a cycle has measured, with this control, these poses and this sphere."""
    paths: frozenset[str] = frozenset()
    """Marks of the control's path in such dry runs."""

    elsewhere: bool = False
    """Whether the reference was measured at other poses or from another origin: then there is none."""
    former_method: str | None = None
    """`[talc] method` of the latest run, if this configuration has another one."""
    other_prior: bool = False
    """Whether the latest run had another prior, or only one of the two has one."""
    changes: tuple[str, ...] = ()
    """Inputs and settings that differ from the latest run's, in words."""


def decide_alike(one: GatewayConfig, other: GatewayConfig) -> bool:
    """Whether controllers with these settings decide alike for the same frames; unused settings do not count."""
    return (
        one.input_names == other.input_names
        and _settings_alike(one.talc, other.talc)
        and (one.talc.method != "learner" or one.prior == other.prior)
    )


def _settings_alike(one: TalcSettings, other: TalcSettings) -> bool:
    return one.method == other.method and used(one) == used(other)


def earlier_run(
    store: Store, config: GatewayConfig, progress: RebuildProgress = go_on, save_every: int = _SAVE_EVERY_STEPS
) -> EarlierRun:
    """`past_of` what a store holds. A damaged one is set aside first, and what can be read of it counts.

    A rebuild of years takes minutes: every `save_every` steps it stores a snapshot, from which the next start
    continues.

    Raises StoreError as `past_of`, or when the damaged one cannot be set aside; SetupError if the computer does not
    have enough memory; Interrupted as `progress`.
    """
    of_this = marks(config)

    def each(found: Rebuilt) -> None:
        progress(found)
        if (snapshot := found.snapshot_if_due(save_every, of_this)) is not None:
            store.keep(snapshot)

    try:
        with store.same_file() as file, History(config.storage.path) as history:
            return past_of(history, config, each)
    except DamagedError as error:
        store.repair(error, file)
    except (Interrupted, StoreError):
        raise
    except MemoryError as error:
        inputs = len(config.input_names)
        raise SetupError(
            Text(NoticeCode.LEARNER_NO_MEMORY, inputs=inputs),
            hint=Text(NoticeCode.LEARNER_USE_LESS),
        ) from error
    except Exception as error:  # noqa: BLE001 - a damaged row may cause any; raised again if the database is whole
        store.repair(error, file)
    with store.same_file(), History(config.storage.path) as history:
        return past_of(history, config, each)


def past_of(history: History, config: GatewayConfig, progress: RebuildProgress = go_on) -> EarlierRun:
    """The controller as an earlier run left it, from its last snapshot and the steps after it.

    Without a snapshot of these settings and this program, it is rebuilt from the whole record with the stored models.
    A fresh start if the record is empty. If the latest run had other inputs, settings, another method or prior, the
    controller is as if the present ones had been used from the beginning of the record, with inputs matched by name.

    Raises StoreError when the record was made with another grid step.
    """
    reference = history.reference()
    if history.config() is None:
        start = start_of(config, history)
        return EarlierRun(
            start.controller,
            last_k=start.last_k,
            moment=history.moment(),
            reference_mm=_reference_of(reference),
            renewing=_is_renewing(reference),
            last_number=history.last_number(),
            paused=history.paused(),
            disarmed=history.disarmed(),
            proven=proven_in(history, config),
            paths=paths_in(history, config),
        )
    before = stored_config(history)
    elsewhere = reference is not None and is_elsewhere(history, reference, config)
    changed = before.talc.method != config.talc.method
    if before.grid != config.grid:
        raise StoreError(
            f"the record was made with [grid] step_s = {before.grid.step_s:g}, not {config.grid.step_s:g}; set it back,"
            " or give [storage] another path to start again"
        )
    found = rebuilt_from(history, config, progress)
    if not found.from_snapshot:  # all that is stored is read once, so that what is damaged is found
        history.measurements()
        history.events()
    return EarlierRun(
        found.controller,
        last_k=found.last_k,
        moment=history.moment(),
        pauses=tuple(history.pauses(uncovered=True)),
        pending=(found.job, found.measure),
        reference_mm=None if elsewhere else _reference_of(reference),
        renewing=elsewhere or _is_renewing(reference),
        last_number=history.last_number(),
        missing=found.missing,
        measured=tuple(found.measured),
        seen=_seen(history, config, found.last_k),
        since_snapshot=found.steps,
        paused=history.paused(),
        disarmed=history.disarmed(),
        proven=proven_in(history, config),
        paths=paths_in(history, config),
        elsewhere=elsewhere,
        former_method=before.talc.method if changed else None,
        other_prior=not changed and config.talc.method == "learner" and before.prior != config.prior,
        changes=(*_inputs_changed(before, config), *(() if changed else _settings_changed(before.talc, config.talc))),
    )


def _reference_of(found: StoredMeasurement | None) -> FloatArray | None:
    if found is None or found.errors is None or found.centres_mm is None:
        return None
    return found.centres_mm + found.in_force_um * 1e-3


def _is_renewing(found: StoredMeasurement | None) -> bool:
    return found is not None and found.errors is None


def _inputs_changed(before: GatewayConfig, after: GatewayConfig) -> Iterator[str]:
    was, now = before.input_names, after.input_names
    for text, names in (("new", set(now) - set(was)), ("gone", set(was) - set(now))):
        if names:
            yield f"{text}: {', '.join(sorted(names))}"
    if was != now and set(was) == set(now):
        yield "another order of the inputs"


def _settings_changed(before: TalcSettings, after: TalcSettings) -> Iterator[str]:
    for one, other in zip(used(before), used(after), strict=True):
        was, now = asdict(one), asdict(other)
        for name in was:
            if was[name] != now[name]:
                yield f"{name} {was[name]} -> {now[name]}"


def _seen(history: History, config: GatewayConfig, last_k: int | None) -> SeenBefore | None:
    """What the sensor check and the planned loads may continue from."""
    if last_k is None:
        return None
    check = config.sensor_check
    planned = rows_remembered(config.grid.step_s) if config.planned_loads else 0
    rows = max(check.learn_steps + check.window_steps, planned)
    frames = history.frames(config.input_names, last_k + 1 - rows, last_k)
    return SeenBefore(frames, history.suspect_since())
