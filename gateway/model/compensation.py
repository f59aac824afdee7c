"""One step of the compensation, as it is stored and published."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Literal


class Source(StrEnum):
    """The basis of the present target."""

    PREDICTION = "prediction"
    STALE = "stale"
    NO_MODEL = "no_model"
    INPUTS_STALE = "inputs_stale"
    """An input of a live model has had no good value for too long."""
    FROZEN = "frozen"
    """The control is probing."""
    NOT_READY = "not_ready"
    """Emergency stop, drives off, axes not referenced."""
    AWAY = "away"
    """The control cannot be reached: its watchdog decides what is in force."""
    STOPPED = "stopped"
    UNANSWERED = "unanswered"
    """A write without an answer may still arrive."""
    NOT_STORED = "not_stored"
    """Nothing could be stored for too long."""
    PAUSED = "paused"
    """A person has paused the compensation."""
    DISARMED = "disarmed"
    """A person has disarmed the gateway."""


Offsets = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the compensation, as stored and published. Micrometres, X Y Z at the tool centre point."""

    target_um: Offsets
    """Target, after the bound and before the slew."""
    offsets_um: Offsets
    """Offsets to be in force from now on."""
    source: Source
    bounded: tuple[bool, bool, bool]
    """Axes that were limited by the bound."""
    coefficients_um: tuple[tuple[float, ...], ...] = ()
    """The coefficients behind `offsets_um`: rows X, Y, Z; see gateway.nc.routes."""


@dataclass(frozen=True, slots=True)
class Write:
    """One step of the compensation with everything that it is based on."""

    time: datetime
    mode: Literal["monitor", "advise", "compensate"]
    step: Step
    k: int | None
    """Grid index of the decision that was used."""
    positions: Mapping[str, float]
    """Axis positions: X Y Z in mm, A C in degrees."""
    written: bool
    """Whether the offsets were sent to the control. It may have received them even if it did not answer."""
    read_back_um: Offsets | None
    """The offsets that the control reports after the write; None if nothing was written or no answer came."""
