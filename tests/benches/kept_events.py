"""A sink that keeps every event for a test to examine."""

from typing import TypeVar

from gateway.model.events import (
    DecisionMade,
    EventReported,
    FrameMade,
    GatewayEvent,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ReadingsTaken,
)
from gateway.model.probing import Outcome, Outlook
from gateway.model.sample import Sample
from talc.frame import Decision, Event, EventKind, Frame
from talc.models import ModelSet

E = TypeVar("E")


class KeptEvents:
    """Keeps every event that it is called with."""

    def __init__(self) -> None:
        self.all: list[GatewayEvent] = []

    def __call__(self, event: GatewayEvent) -> None:
        self.all.append(event)

    def of(self, kind: type[E]) -> list[E]:
        """The events of one class, in order."""
        return [event for event in self.all if isinstance(event, kind)]

    @property
    def readings(self) -> list[Sample]:
        """The readings of all ReadingsTaken, in order."""
        return [reading for event in self.of(ReadingsTaken) for reading in event.readings]

    @property
    def frames(self) -> list[Frame]:
        return [event.frame for event in self.of(FrameMade)]

    @property
    def decisions(self) -> list[Decision]:
        return [event.decision for event in self.of(DecisionMade)]

    @property
    def outcomes(self) -> list[Outcome]:
        return [event.outcome for event in self.of(MeasurementEnded)]

    @property
    def outlooks(self) -> list[Outlook]:
        return [event.outlook for event in self.of(OutlookChanged)]

    @property
    def adopted(self) -> list[ModelSet]:
        return [event.models for event in self.of(ModelsAdopted)]

    @property
    def reported(self) -> list[Event]:
        """What was reported in words, in order."""
        return [event.event for event in self.of(EventReported)]

    def texts(self, *kinds: EventKind) -> list[str]:
        """The texts of the reported events of these kinds, in order."""
        return [event.text for event in self.reported if event.kind in kinds]
