"""The phase that a method is in, and how far it has come."""

from dataclasses import dataclass

from talc.frame import Event
from talc.kinds import EventKind, Phase


@dataclass(slots=True)
class Stage:
    """The phase that a method is in."""

    phase: Phase = Phase.CALIBRATION
    measured: int = 0
    """Measurements since it began, or since the last training that found nothing."""

    def enter(self, phase: Phase, events: list[Event], measured: int = 0) -> None:
        """Begin a phase, also the same one again; a change is one of the events. measured: what counts already."""
        if phase is not self.phase:
            events.append(Event(EventKind.PHASE_CHANGED, f"{self.phase.value} -> {phase.value}"))
        self.phase, self.measured = phase, measured
