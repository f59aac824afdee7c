"""What the clocks said at the end of a grid step."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StepTime:
    """What the clocks said at the end of a grid step."""

    k: int
    origin: str
    """What the monotonic clock counts from (`ServiceClock.origin`)."""
    monotonic_s: float
    lead_s: float
    """How far the numbering of steps is ahead of UTC, because a clock that was ahead was set back."""
    known: bool
    """Whether the wall clock had been synchronised since `origin`."""
