"""The phase that a method is in, and how far it has come."""

from dataclasses import dataclass

from talc.frame import Event
from talc.kinds import EventCode, EventKind, Phase


@dataclass(slots=True)
class Stage:
    """The phase that a method is in."""

    phase: Phase = Phase.CALIBRATION
    measured: int = 0
    """Measurements since it began, or since the last training that found nothing."""

    def enter(self, phase: Phase, events: list[Event], measured: int = 0) -> None:
        """Begin a phase, also the same one again; a change is one of the events. measured: what counts already."""
        if phase is not self.phase:
            values = {"phase": self.phase.value, "next": phase.value}
            events.append(Event(EventKind.PHASE_CHANGED, code=EventCode.PHASE_CHANGED, values=values))
        self.phase, self.measured = phase, measured


def limit_exceeded(error: str, unit: str, value: float, limit: float) -> Event:
    """The residual of an error is above its limit; both in its unit."""
    values = {"error": error, "unit": unit, "value": value, "limit": limit}
    return Event(
        EventKind.LIMIT_EXCEEDED, error=error, value=value, limit=limit, code=EventCode.LIMIT_EXCEEDED, values=values
    )
