"""Makes the published messages from events."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import zip_longest
from typing import NamedTuple, assert_never

import numpy as np
from msgspec.structs import replace

from drivers.base import Clock
from gateway.model.commands import StandingOrder
from gateway.model.compensation import Write
from gateway.model.events import (
    CommandGiven,
    CompensationStepped,
    Configured,
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    GatewayEvent,
    Health,
    HealthChecked,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ProbingRequested,
    ReadingsTaken,
    ReasonsGiven,
    SensorsJudged,
    StorageChanged,
    StoreHealth,
)
from gateway.model.probing import Outcome, Outlook
from gateway.model.sample import Sample
from gateway.model.text import Text, json_of
from gateway.model.wording import finding_text, worded
from gateway.runtime.versions import program_version
from gateway.telemetry import keys
from gateway.telemetry.fields import coded
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    ForecastMessage,
    FrameMessage,
    MeasurementMessage,
    ModelMessage,
    PauseStanding,
    ProbingMessage,
    ProbingStanding,
    Published,
    PublishedReason,
    ReadingMessage,
    ReasonsMessage,
    SensorFinding,
    SensorsMessage,
    StatusMessage,
    StorageStanding,
)
from gateway.telemetry.numbers import by_error, columns_by_error, courses, finite
from talc.explanation import Reasons
from talc.forecast import Forecast, Misses, PlannedForecast
from talc.frame import Decision, Event, Frame
from talc.models import ErrorModel
from talc.names import THERMAL_ERRORS
from talc.sensor_check import Judgement

Keyed = tuple[str, Published]
"""A key below the root, and the message published under it."""


class Dropped(NamedTuple):
    """Messages that were not published, as the network was too slow."""

    readings: int
    """Also compensation steps and states."""
    others: int


@dataclass
class GatewayState:
    """What the status says of the gateway, changed by each event that changes it."""

    commands: bool = False
    """Whether the configuration allows anybody to give commands."""
    config: str | None = None
    """The fingerprint of the configuration that really runs."""
    unarmed: tuple[Text, ...] = ()
    """What the configuration leaves off, in words."""
    certificates: Mapping[str, datetime] = field(default_factory=dict)
    """When they end, by field of the configuration."""
    planned_loads: tuple[str, ...] = ()
    """Their names."""
    kinematics: str = ""
    """The chain of the machine's axes."""
    sphere_mm: tuple[float, float] | None = None
    """Radius and height of the probing sphere."""
    when_stale: str | None = None
    """What the control does with the offsets without a gateway."""
    decision: Decision | None = None
    """The latest."""
    outlook: Outlook | None = None
    """State of probing."""
    storage: StoreHealth | None = None
    """State of the store."""
    health: Health | None = None
    """As it was looked at last; None: not yet."""


class _Stamp(NamedTuple):
    """The fields of every message."""

    boot: str
    seq: int
    time: str
    clock: str


class Composer:
    """Makes messages and numbers them.

    Parameters
    ----------
    boot: identifies this run of the process
    input_names: order of a frame's inputs
    clock: for the time in each message and the age of readings
    simulated: whether the clock is a simulated one
    clock_known: whether the computer's clock is known to be right
    """

    def __init__(
        self,
        boot: str,
        input_names: Sequence[str],
        clock: Clock,
        *,
        simulated: bool,
        clock_known: Callable[[], bool] = lambda: True,
    ) -> None:
        self._boot, self._names, self._clock = boot, tuple(input_names), clock
        self._simulated = simulated
        self._clock_known = clock_known
        self._version = program_version()  # once: its files may be exchanged while the gateway runs
        self._sequence = 0

    def messages(self, event: GatewayEvent) -> list[Keyed]:  # noqa: C901 - one arm for each kind of event
        """The messages of an event."""
        match event:
            case ReadingsTaken(readings):
                now_s = self._clock.monotonic()
                stamps = self._stamps(len(readings))
                named = zip(stamps, readings, strict=True)
                return [(f"{keys.READING}/{r.channel}", _reading(stamp, r, now_s)) for stamp, r in named]
            case FrameMade(frame):
                return [(keys.FRAME, _frame(self._stamp(), frame, self._names))]
            case DecisionMade(decision):
                return [(keys.DECISION, _decision(self._stamp(), decision))]
            case Configured() | ProbingRequested() | StorageChanged() | HealthChecked() | CommandGiven():
                return []  # in the status, but for the second; a command is also an EventReported
            case MeasurementEnded(outcome):
                return [(keys.MEASUREMENT, _measurement(self._stamp(), outcome))]
            case ModelsAdopted(models, after_k):
                live = [model for model in models.models if model is not None]
                return [(f"{keys.MODEL}/{m.error}", _model(self._stamp(), m, after_k)) for m in live]
            case EventReported(reported, k):
                return [(keys.EVENT, _event(self._stamp(), reported, k))]
            case CompensationStepped(write):
                return [(keys.COMPENSATION, _compensation(self._stamp(), write))]
            case OutlookChanged(outlook):
                return [(keys.PROBING, _probing(self._stamp(), outlook))]
            case ReasonsGiven(reasons):
                return [(keys.REASONS, _reasons(self._stamp(), reasons))]
            case ForecastMade(forecast, misses, planned):
                return [(keys.FORECAST, _forecast(self._stamp(), forecast, misses, planned))]
            case SensorsJudged(judgement, k, since_k):
                return [(keys.SENSORS, _sensors(self._stamp(), judgement, k, since_k))]
            case _:
                assert_never(event)

    def status(
        self,
        state: GatewayState,
        dropped: Dropped,
        periods_missed: Mapping[str, int],
        answers_s: Mapping[str, Mapping[int, float]],
    ) -> Keyed:
        """The state as it is now. periods_missed: by bus; answers_s: by bus and unit."""
        decision = state.decision
        message = StatusMessage(
            *self._stamp(),
            phase=None if decision is None else decision.phase.value,
            k=None if decision is None else decision.k,
            readings_dropped=dropped.readings,
            messages_dropped=dropped.others,
            periods_missed=dict(periods_missed),
            answers_s={bus: {str(unit): round(s, 4) for unit, s in of.items()} for bus, of in answers_s.items()},
            config=state.config,
            probing=None if state.outlook is None else _probing_state(state.outlook),
            storage=None if state.storage is None else _storage(state.storage),
            unarmed=tuple(map(str, state.unarmed)),
            unarmed_coded=tuple(map(coded, state.unarmed)),
            certificates={name: ends.isoformat() for name, ends in state.certificates.items()},
            commands=state.commands,
            planned_loads=state.planned_loads,
            kinematics=state.kinematics,
            sphere_mm=state.sphere_mm,
            when_stale=state.when_stale,
            version=self._version,
            key_space=keys.VERSION,
        )
        return keys.STATUS, message if state.health is None else _with_health(message, state.health)

    def _stamp(self) -> _Stamp:
        return self._stamps(1)[0]

    def _stamps(self, count: int) -> list[_Stamp]:
        """Stamps of messages that are published together."""
        first, self._sequence = self._sequence + 1, self._sequence + count
        state = "simulated" if self._simulated else "system" if self._clock_known() else "unsynchronised"
        time = self._clock.utc().isoformat()
        return [_Stamp(self._boot, number, time, state) for number in range(first, first + count)]


def _reading(stamp: _Stamp, r: Sample, now_s: float) -> ReadingMessage:
    return ReadingMessage(
        *stamp,
        channel=r.channel,
        value=finite(r.value),
        unit=r.unit,
        quality=r.quality.value,
        source_time=r.source_time.isoformat(),
        age_s=round(max(0.0, now_s - r.monotonic_s), 3),
        sequence=r.sequence,
        detail=r.detail,
        detail_coded=coded(r.detail),
    )


def _frame(stamp: _Stamp, f: Frame, input_names: Sequence[str]) -> FrameMessage:
    values = zip(input_names, f.inputs.tolist(), f.valid.tolist(), strict=True)
    return FrameMessage(
        *stamp,
        k=f.k,
        inputs={name: finite(value) if ok else None for name, value, ok in values},
        measured=None if f.measurement is None else by_error(f.measurement.errors),
    )


def _decision(stamp: _Stamp, d: Decision) -> DecisionMessage:
    return DecisionMessage(
        *stamp,
        k=d.k,
        phase=d.phase.value,
        predicted=by_error(d.predicted),
        corrected=by_error(d.corrected),
        sigma=by_error(d.sigma),
        limits=by_error(d.limits),
        measure=None if d.measure is None else d.measure.value,
        training=None if d.training is None else d.training.why.value,
        substituted=d.substituted,
        trusted=dict(zip(THERMAL_ERRORS, d.trusted.tolist(), strict=True)),
    )


def _measurement(stamp: _Stamp, o: Outcome) -> MeasurementMessage:
    m = o.measurement
    return MeasurementMessage(
        *stamp,
        number=o.number,
        why=o.why.value,
        asked=o.asked.isoformat(),
        ended=o.ended.isoformat(),
        errors=None if m is None else by_error(m.errors),
        sigma=None if m is None else by_error(m.sigma),
        residual_um=finite(o.residual_um),
        in_force_um=np.asarray(o.in_force_um, dtype=np.float64).tolist(),
        reason=str(o.reason),
        reason_coded=coded(o.reason),
    )


def _model(stamp: _Stamp, m: ErrorModel, after_k: int) -> ModelMessage:
    return ModelMessage(
        *stamp,
        error=m.error,
        after_k=after_k,
        inputs=tuple(m.inputs),
        poles=[finite(abs(complex(p))) for p in m.poles()],
        static_gain=[finite(gain) for gain in m.static_gain()],
        limit=finite(m.limit),
        residual_std=finite(m.residual_std),
        criterion=finite(m.criterion),
    )


def _event(stamp: _Stamp, e: Event, k: int | None) -> EventMessage:
    e = worded(e)
    return EventMessage(
        *stamp,
        k=k,
        kind=e.kind.value,
        text=str(e.text),
        error=e.error,
        value=None if e.value is None else finite(e.value),
        limit=None if e.limit is None else finite(e.limit),
        code=e.code,
        values=json_of(e.values),
    )


def _compensation(stamp: _Stamp, w: Write) -> CompensationMessage:
    return CompensationMessage(
        *stamp,
        k=w.k,
        mode=w.mode,
        source=w.step.source.value,
        target_um=w.step.target_um,
        offsets_um=w.step.offsets_um,
        coefficients_um=w.step.coefficients_um,
        bounded=w.step.bounded,
        positions={axis: finite(position) for axis, position in w.positions.items()},
        written=w.written,
        read_back_um=w.read_back_um,
    )


def _probing(stamp: _Stamp, o: Outlook) -> ProbingMessage:
    state = _probing_state(o)
    return ProbingMessage(*stamp, **{field: getattr(state, field) for field in state.__struct_fields__})


def _probing_state(o: Outlook) -> ProbingStanding:
    why = None if o.why is None else o.why.value
    texts = str(o.reason), o.rejected, str(o.operator)
    return ProbingStanding(o.standing.value, why, *texts, coded(o.reason), coded(o.operator))


def _with_health(status: StatusMessage, h: Health) -> StatusMessage:
    return replace(
        status,
        uptime_s=round(h.uptime_s, 1),
        channels=h.channels,
        channels_good=h.channels_good,
        nc=h.nc,
        clock_synchronised=h.clock_synchronised,
        waits_for=tuple(map(str, h.waits_for)),
        waits_for_coded=tuple(map(coded, h.waits_for)),
        paused=_order(h.paused),
        disarmed=_order(h.disarmed),
    )


def _order(order: StandingOrder | None) -> PauseStanding | None:
    return None if order is None else PauseStanding(order.by, order.since.isoformat())


def _storage(h: StoreHealth) -> StorageStanding:
    free_mb = None if h.free_mb is None else round(h.free_mb)
    oldest_s = None if h.oldest_s is None else round(h.oldest_s, 1)
    return StorageStanding(str(h.problem), h.waiting, h.dropped, free_mb, oldest_s, coded(h.problem))


def _sensors(stamp: _Stamp, j: Judgement, k: int, since_k: tuple[int, ...]) -> SensorsMessage:
    findings = (
        SensorFinding(
            f.kind,
            f.inputs,
            f.alternatives,
            finite(f.offset_K),
            finite(f.score),
            str(finding_text(f.kind, f.inputs, f.offset_K, f.alternatives)),
            since,
        )
        for f, since in zip_longest(j.findings, since_k[: len(j.findings)])
    )
    return SensorsMessage(
        *stamp,
        k=k,
        findings=tuple(findings),
        smallest_offset_K={name: finite(value) for name, value in j.smallest_offset_K.items()},
        alike=j.alike,
        loads=j.loads,
    )


def reason_of_each(r: Reasons) -> dict[str, PublishedReason]:
    """By thermal error, as they are published."""
    return {
        e.error: PublishedReason(
            estimate=finite(e.estimate),
            trusted=e.trusted,
            believed=finite(e.believed),
            inputs={name: finite(value) for name, value in e.inputs},
            other_inputs=finite(e.other_inputs),
            level=finite(e.level),
            experts={kind: finite(share) for kind, share in e.experts},
            expected=finite(e.expected),
            expected_sigma=finite(e.expected_sigma),
        )
        for e in r.errors
    }


def _reasons(stamp: _Stamp, r: Reasons) -> ReasonsMessage:
    return ReasonsMessage(*stamp, k=r.k, next_k=r.next_k, next_why=r.next_why.value, errors=reason_of_each(r))


def _forecast(
    stamp: _Stamp, f: Forecast, misses: Misses, planned: Mapping[str, PlannedForecast | None]
) -> ForecastMessage:
    return ForecastMessage(
        *stamp,
        k=f.k,
        ahead_s=f.ahead_s,
        stays=courses(f.value, f.sigma),
        usual=courses(f.usual_value, f.usual_sigma),
        measured=columns_by_error(f.measured_sigma),
        missed=courses(misses.value, misses.sigma),
        planned={name: {} if each is None else courses(each.value, each.sigma) for name, each in planned.items()},
    )
