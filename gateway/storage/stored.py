"""Values read from the database."""

from dataclasses import dataclass
from datetime import datetime

from talc.frame import Decision, FloatArray, Frame
from talc.models import ModelSet


@dataclass(frozen=True, slots=True)
class StoredStep:
    """One grid step as stored, and the models that were adopted after it."""

    frame: Frame
    decision: Decision
    """Without its training job: `training_wanted` says whether it had one."""
    training_wanted: str | None
    adopted: tuple[ModelSet, ...]
    trust_known: bool = True
    """False for an earlier program, which did not store `decision.trusted`."""


@dataclass(frozen=True, slots=True)
class StoredMeasurement:
    """One probing cycle as stored."""

    number: int
    why: str
    ended: datetime
    centres_mm: FloatArray | None
    in_force_um: FloatArray
    errors: FloatArray | None
    reason: str
    asked: datetime


@dataclass(frozen=True, slots=True)
class StoredRun:
    """One start of the gateway as stored, and the settings with which the machine is learnt."""

    number: int
    began: datetime
    kind: str | None
    """Kind of the machine; None: it has none."""
    step_s: float
    inputs: tuple[str, ...]
    talc: str
    """The section, JSON."""
    fingerprint: str
    versions: str


@dataclass(frozen=True, slots=True)
class StoredCompensation:
    """One step of the compensation as stored."""

    time: datetime
    mode: str
    source: str
    offsets_um: FloatArray
    written: bool
