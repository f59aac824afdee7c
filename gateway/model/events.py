"""Everything that a running gateway reports, as a closed union of events, and its distribution to receivers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from gateway.model.commands import CommandOutcome, Disarmed, Pause
from gateway.model.compensation import Write
from gateway.model.connection import Connection
from gateway.model.control_state import NcState
from gateway.model.notice import Notify
from gateway.model.probing import Outcome, Outlook
from gateway.model.sample import Sample
from gateway.model.step_time import StepTime
from gateway.model.text import NOTHING, Text
from gateway.model.wording import problem_event
from talc.explanation import Reasons
from talc.forecast import Forecast, Misses, PlannedForecast
from talc.frame import Decision, Event, Frame
from talc.models import ModelSet
from talc.sensor_check import Judgement


@dataclass(frozen=True, slots=True, eq=False)
class Configured:
    """A configuration is now in use: at the start, and after each reload that took effect.

    `gateway.config.applied` has the event with the configuration itself.
    """


@dataclass(frozen=True, slots=True, eq=False)
class ReadingsTaken:
    """Channels were read, or went stale."""

    readings: Sequence[Sample]


@dataclass(frozen=True, slots=True, eq=False)
class FrameMade:
    """A grid step has ended."""

    frame: Frame
    moment: StepTime | None = None
    """The clocks at that time; None: not reported."""


@dataclass(frozen=True, slots=True, eq=False)
class DecisionMade:
    """The controller has decided on the last frame."""

    decision: Decision


@dataclass(frozen=True, slots=True)
class ProbingRequested:
    """A probing cycle is about to be requested from the control. Its number must never be used again, so the request
    waits until the store has it on the disk."""

    number: int


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementEnded:
    """A requested measurement has succeeded, failed, or was refused."""

    outcome: Outcome


@dataclass(frozen=True, slots=True, eq=False)
class ModelsAdopted:
    """The controller uses other models from the next step on."""

    models: ModelSet
    after_k: int
    """Grid index of the last step before them."""


@dataclass(frozen=True, slots=True)
class EventReported:
    """The controller or the service reports something in words."""

    event: Event
    k: int | None
    """Grid index that it belongs to, or None."""


@dataclass(frozen=True, slots=True, eq=False)
class CompensationStepped:
    """The compensation took a step; in some modes nothing is written to the control."""

    write: Write


@dataclass(frozen=True, slots=True)
class OutlookChanged:
    """A wanted measurement has another state or another reason."""

    outlook: Outlook


@dataclass(frozen=True, slots=True, eq=False)
class SensorsJudged:
    """The sensors were compared with each other."""

    judgement: Judgement
    k: int
    """Grid index of the last frame of the window."""
    since_k: tuple[int, ...] = ()
    """For each finding, `k` of the first judgement of this run since which it has been found."""


@dataclass(frozen=True, slots=True)
class StoreHealth:
    """The state of storing."""

    problem: Text = NOTHING
    """Why rows wait in memory or were refused; empty: all is well."""
    failing_s: float = 0.0
    """For how long nothing could be stored, real seconds."""
    waiting: int = 0
    """Rows that wait in memory."""
    dropped: int = 0
    """Rows that were dropped because too many waited: raw readings, steps of the compensation, events; never more."""
    free_mb: float | None = None
    """Free space on the disk; None: unknown."""
    mended: Text = NOTHING
    """What became of a damaged database; empty: it was whole."""
    oldest_s: float | None = None
    """How long the oldest of the waiting rows has waited, real seconds; None: none waits."""


@dataclass(frozen=True, slots=True)
class StorageChanged:
    """Storing has begun to fail, works again, or the disk's free space has passed its limit."""

    health: StoreHealth


@dataclass(frozen=True, slots=True)
class Health:
    """The condition of the gateway."""

    uptime_s: float
    """Since the service began to run."""
    channels: int
    """Channels of the configuration."""
    channels_good: int
    """How many of these channels have a good value now."""
    nc: NcState
    clock_synchronised: bool | None
    """Whether the computer's clock is kept by a time server; None: unknown, or the clock is simulated."""
    waits_for: tuple[Text, ...]
    """What must happen before the gateway learns and corrects fully, one text each."""
    store: StoreHealth
    paused: Pause | None = None
    """The compensation's pause; None: it is not paused."""
    disarmed: Disarmed | None = None
    """Who has disarmed the gateway; None: nobody."""
    telemetry: Connection | None = None
    """How the telemetry is connected; None: it is off."""


@dataclass(frozen=True, slots=True)
class HealthChecked:
    """The gateway's health was looked at, every 10 s."""

    health: Health


@dataclass(frozen=True, slots=True)
class CommandGiven:
    """A person has given a command, which was accepted or refused."""

    outcome: CommandOutcome


@dataclass(frozen=True, slots=True)
class ReasonsGiven:
    """The learner says why its estimates are what they are: after each measurement, and each hour."""

    reasons: Reasons


@dataclass(frozen=True, slots=True)
class ForecastMade:
    """The learner's forecast of its estimates, after each step."""

    forecast: Forecast
    misses: Misses
    """How far such forecasts have been off."""
    planned: Mapping[str, PlannedForecast | None] = field(default_factory=dict)
    """By planned load, at the same times; None: its effect is not known yet."""


GatewayEvent = (
    Configured
    | ReadingsTaken
    | FrameMade
    | DecisionMade
    | ProbingRequested
    | MeasurementEnded
    | ModelsAdopted
    | EventReported
    | CompensationStepped
    | OutlookChanged
    | SensorsJudged
    | StorageChanged
    | HealthChecked
    | CommandGiven
    | ReasonsGiven
    | ForecastMade
)

Sink = Callable[[GatewayEvent], None]
"""Receives every event in order, in the event loop's thread, and returns at once."""


def problems_to(sink: Sink) -> Notify:
    """What reports each problem, as it begins and as it ends, to a sink."""
    return lambda notice: sink(EventReported(problem_event(notice), None))


Kind = TypeVar("Kind")


class Events:
    """Passes each event to those who have subscribed to its type, in the order in which they have subscribed.

    All of them have it before the next event comes, unless one of them publishes another.
    """

    def __init__(self, *sinks: Sink) -> None:
        self._subscribers: list[tuple[type, Callable[[Any], None]]] = []
        self.subscribe_to_all(*sinks)

    def subscribe(self, kind: type[Kind], take: Callable[[Kind], None]) -> None:
        """From now on `take` gets every event of this type."""
        self._subscribers.append((kind, take))

    def subscribe_to_all(self, *sinks: Sink) -> None:
        """From now on these get every event."""
        self._subscribers += [(object, sink) for sink in sinks]

    def publish(self, event: GatewayEvent) -> None:
        """A sink: tell everyone who has subscribed to it."""
        for kind, take in self._subscribers:
            if isinstance(event, kind):
                take(event)
