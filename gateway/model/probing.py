"""A wanted measurement: the outlook on it, and the outcome of a request."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from drivers.nc import Triple
from gateway.model.standing import Standing
from gateway.model.text import NOTHING, Text
from talc.frame import FloatArray, Measurement, Why


class End(StrEnum):
    """How a request ended."""

    MEASURED = "measured"
    REFUSED = "refused"
    """The control did not begin the cycle, or could not be reached."""
    REJECTED = "rejected"
    """The cycle failed, or its result cannot be used."""


InForce = Triple | tuple[Triple, ...]
"""Compensation in force during a cycle, µm: the same at all poses, or one for each."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one request; `measurement` is None when it was refused, failed or implausible."""

    number: int
    """Number of the last cycle requested."""
    why: Why
    asked: datetime
    ended: datetime
    centres_mm: FloatArray | None
    """(poses, 3) as the control reported them; for the reference, the mean of its cycles."""
    in_force_um: InForce
    """Compensation held during the cycle, removed from the centres before solving."""
    measurement: Measurement | None
    residual_um: float
    """RMS of what the nine errors do not explain; NaN without a result."""
    reason: Text = NOTHING
    end: End = End.MEASURED

    def __post_init__(self) -> None:
        if (self.end is End.MEASURED) != (self.measurement is not None):
            raise ValueError(
                f"end = {self.end.value!r} with measurement = {self.measurement!r}: they contradict each other"
            )


@dataclass(frozen=True, slots=True)
class Outlook:
    """State of the wanted measurement, and why."""

    standing: Standing
    why: Why | None
    """Why the measurement is wanted; `retry` after a rejected one."""
    reason: Text = NOTHING
    """Why nothing is requested yet; equal while the reason is the same."""
    rejected: int = 0
    """Results rejected in a row."""
    operator: Text = NOTHING
    """Message for the operator; empty: none."""
