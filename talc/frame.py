"""The controller's inputs and outputs: frozen values.

`controller.step(frame) -> decision`; `train(decision.training) -> models`; `controller.adopt(models)`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from talc.kinds import EventCode, EventKind, Phase, Why
from talc.settings import TrainingSettings

__all__ = [
    "LARGEST_ERROR",
    "LARGEST_INPUT",
    "LEAST_VALID",
    "BoolArray",
    "Decision",
    "Event",
    "EventCode",
    "EventKind",
    "FloatArray",
    "Frame",
    "Frames",
    "IntArray",
    "Measurement",
    "Phase",
    "TrainingJob",
    "Why",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

LARGEST_INPUT: Final = 1e12
"""Magnitude of an input, in whatever unit. A larger number is not a value: its squares and sums would overflow."""
LEAST_VALID: Final = 0.8
"""Share of good rows below which nothing is learnt from an input, nor about it."""
LARGEST_ERROR: Final = 1e6
"""Magnitude of a thermal error: a metre, or a metre per metre."""


@dataclass(frozen=True, slots=True)
class Event:
    """One thing to report; `error` is set when it concerns one thermal error."""

    kind: EventKind
    text: str = ""
    """In words, where somebody has put it into words: the controller does not."""
    error: str | None = None
    value: float | None = None
    limit: float | None = None
    code: str = ""
    """What it says: an EventCode, or a code of the service; empty: only the text tells."""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """What belongs to the code."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """The nine errors from one probing cycle."""

    errors: FloatArray
    """(9,) µm, µm/m for the last three, in the order of THERMAL_ERRORS; NaN: not determined."""
    sigma: FloatArray
    """(9,) standard uncertainties, same units."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Everything of one grid step."""

    k: int
    """Grid index: UTC seconds // grid step. Strictly increasing; gaps are allowed."""
    inputs: FloatArray
    """(n,) temperatures in degC, spindle growth in µm, machine states, in the controller's input order."""
    valid: BoolArray
    """(n,) False where the input had no good value in this step (its number is then meaningless)."""
    measurement: Measurement | None = None
    """Set if a probing cycle has finished for this step."""
    pause_unknown: bool = False
    """The time since the frame before is not known, as after a restart without a synchronised clock."""
    new_reference: bool = False
    """From this frame on errors count from its own state, in which they are zero: the sphere was moved, the part was
    clamped again, or another run of a recording begins."""
    tolerance_um: float | None = None
    """How far off may be what is machined next, as the part program states it, µm; 0: it states nothing; None: as
    before."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Many frames as arrays, oldest first; steps without one are left out."""

    k: IntArray
    """(m,) grid indices."""
    inputs: FloatArray
    """(m, n); `valid` likewise."""
    valid: BoolArray
    measured: FloatArray
    """(m, 9) errors, NaN where nothing was measured."""


@dataclass(frozen=True, slots=True)
class TrainingJob:
    """Everything that a training needs, as a value."""

    k: int
    """Grid index of the step that requested it."""
    why: Why
    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, n), consecutive grid steps, the last one at index k."""
    valid: BoolArray
    """(T, n)"""
    measured: FloatArray
    """(T, 9), NaN where nothing was measured."""
    settings: TrainingSettings
    static_inputs: tuple[tuple[str, ...] | None, ...] | None = None
    """Inputs to keep, one tuple per thermal error, None where none were chosen yet; None: choose for all."""
    estimated: FloatArray | None = None
    """(T, 9) what was estimated at the time in rows before a measurement; NaN: there was no model, or not needed."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What the controller makes of one frame."""

    k: int
    phase: Phase
    predicted: FloatArray
    """(9,) errors at k; NaN where no model exists.

    If the frame contained a measurement: the prediction before it."""
    corrected: FloatArray
    """(9,) best estimate at k, after the state update; what compensation uses. NaN: no estimate."""
    sigma: FloatArray
    """(9,) standard uncertainty of `corrected`; NaN where unknown."""
    limits: FloatArray
    """(9,) action control limits; NaN before the first models."""
    measure: Why | None
    """Set when a measurement is wanted for the next step."""
    training: TrainingJob | None
    """Set when a training is wanted. The caller runs it and hands the result to `adopt`."""
    events: tuple[Event, ...]
    substituted: tuple[str, ...] = ()
    """Inputs without a good value in this step. For those of live models the last good value is used; for all of the
    learner's, the value that the other inputs imply."""
    trusted: BoolArray = field(default_factory=lambda: np.ones(9, dtype=np.bool_))
    """(9,) the estimate is better than no correction; where not, the learner's `corrected` is 0."""
