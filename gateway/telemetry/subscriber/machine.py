"""Messages received from one machine: the latest of each kind, and those of the last eight hours."""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import assert_never

import msgspec

from gateway.model.compensation import Source
from gateway.model.text import Text
from gateway.telemetry.fields import texts_from
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    ForecastMessage,
    FrameMessage,
    MeasurementMessage,
    ModelMessage,
    ProbingMessage,
    ProbingStanding,
    Published,
    ReadingMessage,
    ReasonsMessage,
    SensorsMessage,
    StatusMessage,
)
from gateway.telemetry.subscriber.instants import instant
from talc.kinds import Phase, Why
from talc.names import THERMAL_ERRORS

KEPT = timedelta(hours=8)
"""How much of the past the charts show."""
# Bounds of what anybody who may publish can make this process keep.
_MOST_DECISIONS = 2000
_MOST_MEASUREMENTS = 200
_MOST_EVENTS = 200
_MOST_KEYS = 1000
_MOST_EXPLAINED = 40


OLD_S = 900.0
"""An estimate older than this is no longer shown as current; by default the compensation no longer uses it either."""
_STEPS_MISSED = 3.0
SILENT_S = 60.0
"""A running gateway reports its state every 10 s."""
_LARGEST = 1e6
"""µm or µm/m. What exceeds it is neither a thermal error nor an offset of a machine: it counts as unknown."""
_LEAST_MM, _MOST_MM = 1.0, 5000.0
"""Radius and height of a sphere on a table are within these."""


def believable(value: float | None) -> float:
    """NaN: none was published, or an absurd one."""
    return value if value is not None and abs(value) <= _LARGEST else math.nan


def nine(values: dict[str, float | None] | None) -> tuple[float, ...]:
    """The nine thermal errors in their order; NaN: none was published, or an absurd one."""
    found = {} if values is None else values
    return tuple(believable(found.get(name)) for name in THERMAL_ERRORS)


@dataclass(frozen=True, slots=True)
class Applied:
    """What the control has in force. µm, X Y Z at the tool."""

    following: bool
    """Whether it takes back the predicted errors, wherever the tool is."""
    offsets_um: tuple[float, float, float]
    """In force, at the tool's own position; NaN: the control has not taken the latest step, so this is not known."""
    to_come_um: tuple[float, float, float]
    """What the slew has still to add."""
    bounded: tuple[bool, bool, bool]
    """Axes at their bound, where more is not taken back."""


_NONE = (0.0, 0.0, 0.0)
_UNKNOWN = (math.nan, math.nan, math.nan)
_UNBOUNDED = (False, False, False)


def applied(message: CompensationMessage | None) -> Applied:
    """What the latest step of the compensation leaves in force; advice takes back nothing."""
    if message is None or message.mode != "compensate":
        return Applied(False, _NONE, _NONE, _UNBOUNDED)
    in_force = _axes(message.offsets_um)
    if message.source == Source.FROZEN:
        return Applied(False, in_force, _NONE, message.bounded)
    if not message.written:
        return Applied(False, _UNKNOWN, _NONE, message.bounded)
    x, y, z = (target - now for target, now in zip(_axes(message.target_um), in_force, strict=True))
    return Applied(message.source == Source.PREDICTION, in_force, (x, y, z), message.bounded)


def _axes(offsets_um: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = map(believable, offsets_um)
    return x, y, z


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """The estimate of one grid step."""

    at: datetime
    errors: tuple[float, ...]
    """Best estimate of the nine, µm and µm/m."""
    sigma: tuple[float, ...]
    applied: Applied
    no_good: bool = False
    """The phase was `no_good`: the estimate does not fit."""
    anew: bool = False
    """The first since the gateway began again, or was away."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredErrors:
    """One measurement that was used."""

    at: datetime
    errors: tuple[float, ...]
    sigma: tuple[float, ...]
    """Nine each."""
    residual_um: float | None = None
    """RMS of what the nine errors do not explain: how far the touches scatter."""
    lasted_s: float | None = None
    """From the request to its end; None: unknown, or of the reference, which takes several cycles."""


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """What the learner gave as its reasons, and what was known then."""

    reasons: ReasonsMessage
    sigma: dict[str, float | None]
    """By thermal error, of the decision at that step."""
    measured: datetime | None
    """When the last measurement that was used had ended."""


@dataclass(slots=True)
class MachineSeen:
    """One machine as its messages show it. Times are UTC: the gateway's own in messages, this computer's in `heard`.

    Parameters
    ----------
    machine: its name
    """

    machine: str
    alive: bool = False
    """Whether its liveliness token is there."""
    heard: datetime | None = None
    """When this process last received anything, or saw the token."""
    gone: datetime | None = None
    """When the token disappeared."""
    silent: bool = False
    """The token is there, and nothing has come for SILENT_S: it hangs, or what it publishes is lost."""
    two: bool = False
    """Two gateways have this name; the messages of one of them are here."""
    boot: str = ""
    latest: datetime | None = None
    """The gateway's time of the latest message, and when it was received, monotonic seconds."""
    latest_s: float = 0.0
    simulated: bool = False
    frame: FrameMessage | None = None
    decision: DecisionMessage | None = None
    compensation: CompensationMessage | None = None
    status: StatusMessage | None = None
    probing: ProbingStanding | None = None
    probing_since: datetime | None = None
    """When the measurement began to stand so; None: not heard."""
    reasons: ReasonsMessage | None = None
    forecast: ForecastMessage | None = None
    sensors: SensorsMessage | None = None
    step_s: float | None = None
    """Step of the grid, from the time and index of two decisions."""
    readings: dict[str, ReadingMessage] = field(default_factory=dict)
    estimates: deque[Estimated] = field(default_factory=lambda: deque(maxlen=_MOST_DECISIONS))
    measurements: deque[MeasuredErrors] = field(default_factory=lambda: deque(maxlen=_MOST_MEASUREMENTS))
    last_measurement: MeasurementMessage | None = None
    events: deque[EventMessage] = field(default_factory=lambda: deque(maxlen=_MOST_EVENTS))
    explained: deque[Explained] = field(default_factory=lambda: deque(maxlen=_MOST_EXPLAINED))
    explanations: int = 0
    """How many have ever come; changes with `explained`."""
    past: int = 0
    """Changes with what the charts show."""
    back_s: float | None = None
    """Monotonic seconds at which it was heard again after it was gone, silent or ended; None: it never was."""
    _away: bool = False
    """It is gone, silent or ended, and was not heard since."""
    _anew: bool = False
    """It was, and has decided nothing since."""
    _sequence: dict[str, int] = field(default_factory=dict)
    """Sequence number of the latest message, by key."""
    _newest: int = -1
    """The highest of all of this run."""

    def appear(self, now: datetime) -> None:
        """The liveliness token is there. What was heard before it went does not hold until it is heard again."""
        if self.gone is not None:
            self._begin_again(self.boot)
        self.alive, self.heard, self.gone = True, now, None

    @property
    def present(self) -> bool:
        """Whether what was heard last may be what is now."""
        return self.alive and not (self.silent or self.two)

    @property
    def sphere_mm(self) -> tuple[float, float] | None:
        """Radius and height of the probing sphere; None: the gateway does not tell, or absurd ones."""
        told = None if self.status is None else self.status.sphere_mm
        return told if told is not None and _LEAST_MM <= told[0] <= _MOST_MM and abs(told[1]) <= _MOST_MM else None

    @property
    def unarmed(self) -> tuple[Text, ...]:
        """What its configuration leaves off; nothing is known of one that is not present."""
        status = self.status
        return texts_from(status.unarmed, status.unarmed_coded) if self.present and status is not None else ()

    def listen(self, now_s: float) -> None:
        """See whether it is silent at this monotonic time."""
        self.silent = self.alive and self.latest is not None and now_s - self.latest_s > SILENT_S
        self._away |= self.silent

    def disappear(self, now: datetime) -> None:
        """The liveliness token is gone, and with it everything that was fresh."""
        if self.alive or self.gone is None:
            self.alive, self.gone = False, now

    def apply(self, suffix: str, message: Published, now: datetime, now_s: float) -> None:
        """Take in one message; one that a query brought may be older than what is known of its key.

        suffix: its key below the machine; now, now_s: when it was received, this computer's UTC and monotonic seconds
        """
        at = instant(message.time)
        if at is None or (suffix not in self._sequence and len(self._sequence) >= _MOST_KEYS):
            return
        self.heard = now
        if message.boot != self.boot:
            self._begin_again(message.boot)
        if message.seq <= self._sequence.get(suffix, -1):
            return
        self._sequence[suffix] = message.seq
        if self._away:
            self._away, self.back_s = False, now_s
        if self.latest is None or message.seq > self._newest:  # its clock may have been set back meanwhile
            self._newest, self.latest, self.latest_s = message.seq, at, now_s
        self.simulated = message.clock == "simulated"
        self._take(message, at)

    def _begin_again(self, boot: str) -> None:
        """The gateway is another one, or was away: nothing that was heard holds for now. The past is kept."""
        self._away = self._anew = self.boot != ""
        self.boot, self.latest, self._newest = boot, None, -1
        self.frame, self.decision, self.compensation = None, None, None
        self.status, self.probing, self.probing_since = None, None, None
        self.reasons, self.forecast, self.sensors = None, None, None
        self.readings.clear()
        self._sequence.clear()

    def _stands(self, probing: ProbingStanding, at: datetime | None) -> None:
        if self.probing is None or self.probing.standing != probing.standing or self.probing_since is None:
            self.probing_since = at
        self.probing = probing

    def _take(self, message: Published, at: datetime) -> None:  # noqa: C901 - one arm for each kind of message
        match message:
            case ReadingMessage():
                self.readings[message.channel] = message
            case DecisionMessage():
                self._decided(message, at)
            case CompensationMessage():
                self._stepped(message)
            case MeasurementMessage():
                self._measured(message)
            case ProbingMessage():
                self._stands(msgspec.convert(message, ProbingStanding, from_attributes=True), at)
            case ReasonsMessage():
                self.reasons = message
                self._explain(message)
            case SensorsMessage():
                self.sensors = message
            case ForecastMessage():
                self.forecast = message
                self.past += 1
            case StatusMessage():
                self.status = message
                if message.probing is not None:
                    self._stands(message.probing, None)
            case EventMessage():
                if not self.events or (self.events[-1].boot, self.events[-1].seq) != (message.boot, message.seq):
                    self.events.append(message)
            case FrameMessage():
                self.frame = message
            case ModelMessage():
                pass  # not shown
            case _:
                assert_never(message)

    def _decided(self, message: DecisionMessage, at: datetime) -> None:
        before = self.decision
        if before is not None and message.k > before.k and (earlier := instant(before.time)) is not None:
            self.step_s = (at - earlier).total_seconds() / (message.k - before.k)
        self.decision = message
        while self.estimates and self.estimates[-1].at > at:
            self.estimates.pop()  # the gateway's clock was set back
        if self.estimates and self.estimates[-1].at == at:
            return  # it is known from before the gateway was away
        self.past += 1
        now, no_good = applied(self.compensation), message.phase == Phase.NO_GOOD
        self.estimates.append(
            Estimated(at, nine(message.corrected), nine(message.sigma), now, no_good, anew=self._anew)
        )
        self._anew = False
        while self.estimates and self.estimates[0].at < at - KEPT:
            self.estimates.popleft()
        while self.measurements and self.measurements[0].at < at - KEPT:
            self.measurements.popleft()

    def _stepped(self, message: CompensationMessage) -> None:
        """What is in force now is what became of the latest decision."""
        self.compensation = message
        if self.estimates and self.decision is not None and message.k == self.decision.k:
            before, now = self.estimates[-1], applied(message)
            self.estimates[-1] = replace(before, applied=now)
            self.past += before.applied.following != now.following

    def _explain(self, message: ReasonsMessage) -> None:
        last = self.explained[-1].reasons if self.explained else None
        if last is not None and (last.boot, last.k) == (message.boot, message.k):
            return  # it is known from before the gateway was away
        same = self.decision is not None and self.decision.k == message.k
        sigma = self.decision.sigma if self.decision is not None and same else {}
        used = self.measurements[-1].at if self.measurements else None
        self.explained.append(Explained(message, sigma, used))
        self.explanations += 1

    def _measured(self, message: MeasurementMessage) -> None:
        ended = instant(message.ended)
        if ended is None:
            return
        self.last_measurement = message
        if message.errors is not None and not (self.measurements and ended <= self.measurements[-1].at):
            self.past += 1
            asked = instant(message.asked) if message.why != Why.REFERENCE else None
            lasted_s = None if asked is None or asked > ended else (ended - asked).total_seconds()
            self.measurements.append(
                MeasuredErrors(ended, nine(message.errors), nine(message.sigma), message.residual_um, lasted_s)
            )

    def clock(self, now_s: float) -> datetime | None:
        """The gateway's own time now, as far as its latest message tells; None: nothing was heard."""
        return None if self.latest is None else self.latest + timedelta(seconds=max(0.0, now_s - self.latest_s))

    def back(self, now_s: float) -> datetime | None:
        """When it was heard again after it was away, by its own clock; None: it never was."""
        clock = self.clock(now_s)
        return None if clock is None or self.back_s is None else clock - timedelta(seconds=now_s - self.back_s)

    def age_s(self, at: str, now_s: float) -> float | None:
        """How old something is that carries this time of the gateway; None: the time cannot be read."""
        then, clock = instant(at), self.clock(now_s)
        return None if then is None or clock is None else max(0.0, (clock - then).total_seconds())

    def at_k(self, k: int) -> datetime | None:
        """The time of a grid index; None until the length of a grid step is known."""
        decided = None if self.decision is None else instant(self.decision.time)
        if self.decision is None or decided is None or self.step_s is None:
            return None
        try:
            return decided + timedelta(seconds=(k - self.decision.k) * self.step_s)
        except OverflowError:
            return None


def holds_s(seen: MachineSeen) -> float:
    """How long an estimate counts as current, seconds."""
    return max(OLD_S, _STEPS_MISSED * (seen.step_s or 0.0))


def is_past(seen: MachineSeen, time: datetime) -> bool:
    """Whether this time of the gateway has passed, by its latest message."""
    return seen.latest is not None and time < seen.latest


def is_old(seen: MachineSeen, now_s: float) -> bool:
    """Whether the latest decision is too old to be current."""
    if seen.decision is None:
        return False
    age_s = seen.age_s(seen.decision.time, now_s)
    return age_s is None or age_s > holds_s(seen)
