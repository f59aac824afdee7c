"""The interface of numerical controls. Units are those of the NC, mm and degrees; offsets are in µm."""

import math
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Final, Protocol, runtime_checkable

from drivers.base import Quality

Triple = tuple[float, float, float]
"""X, Y, Z."""

LINEAR_AXES = ("X", "Y", "Z")
ROTARY_AXES = ("A", "C")
LARGEST_NUMBER: Final = 2**31 - 1
"""Largest number of a request or an owner that a control keeps exactly, as an integer or a floating-point number."""


class ProbingState(StrEnum):
    """State of one probing request."""

    IDLE = "idle"
    REQUESTED = "requested"
    ACCEPTED = "accepted"
    RUNNING = "running"
    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"


class OperatingMode(StrEnum):
    """What the operator has selected."""

    JOG = "jog"
    MDA = "mda"
    AUTO = "auto"
    UNKNOWN = "unknown"


class ProgramState(StrEnum):
    """What the part program does."""

    RUNNING = "running"
    WAITING = "waiting"
    STOPPED = "stopped"
    INTERRUPTED = "interrupted"
    ABORTED = "aborted"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class NcSnapshot:
    """The control's state at one moment."""

    time: datetime
    """UTC, when it was read."""
    monotonic_s: float
    positions: dict[str, float]
    """Axis name to actual position: X Y Z in mm from where A and C meet, A C in degrees."""
    states: dict[str, float] = field(default_factory=dict)
    """Machine states that models use: spindle_speed (1/min), speed_X .. speed_C (mm/min, 1/min), coolant (0/1).

    A state without a good value is missing."""
    mode: OperatingMode = OperatingMode.UNKNOWN
    program: ProgramState = ProgramState.UNKNOWN
    tool: int | None = None
    """Number of the tool in the spindle; None: not known."""
    probe_in_spindle: bool | None = None
    alarms: tuple[int, ...] = ()
    """Numbers of the alarms that are shown, the first few of them."""
    ready: bool | None = None
    """False: emergency stop, drives off or an axis not referenced, so that an offset may not act when it is written, or
    act later all at once. None: the control does not report it."""
    cannot_probe: str | None = None
    """Why no cycle can begin as the control stands; empty: one can, whatever the mode, in a part program at its next
    safe point. None: the control does not report it, and cycles begin in AUTO only."""
    probing: bool | None = None
    """Whether a probing cycle is under way, whoever asked for it; None: the control does not report it."""
    quality: Quality = Quality.GOOD


@dataclass(frozen=True, slots=True)
class ProbingStatus:
    """Where the cycle of request `number` stands."""

    number: int
    state: ProbingState
    centres_mm: tuple[tuple[float, float, float], ...] | None = None
    """When done: the sphere's centre at each pose (X, Y, Z) as measured."""
    reason: str = ""
    """Why refused or failed."""
    spread_mm: float | None = None
    """When done: largest difference between repeated touches of one point; None: the control does not report it."""


@dataclass(frozen=True, slots=True)
class WatchdogTerms:
    """What the control's watchdog does when the gateway falls silent. Raises ValueError for an invalid field."""

    silence_s: float
    """After this time without a heartbeat the gateway counts as dead."""
    ramp_um_per_s: float
    """Rate at which the offsets then go to zero; 0 holds them."""

    def __post_init__(self) -> None:
        if not 0 < self.silence_s < math.inf:
            raise ValueError(f"silence_s = {self.silence_s!r}: expected more than 0")
        if not 0 <= self.ramp_um_per_s < math.inf:
            raise ValueError(f"ramp_um_per_s = {self.ramp_um_per_s!r}: expected 0 or more")


@dataclass(frozen=True, slots=True)
class LinearOffsets:
    """A shift of the tool that depends on where the linear axes stand: K0 + tanβ (P - P0)."""

    k0_um: Triple
    """Shift of X, Y, Z where every axis stands at its reference."""
    slope_um_per_mm: tuple[Triple, Triple, Triple]
    """Row: shifted axis; column: axis whose position counts."""
    reference_mm: Triple
    """P0 of X, Y, Z, counted as a snapshot's positions."""

    def at(self, position_mm: Triple) -> Triple:
        """Shift of X, Y, Z in µm at a position, counted as a snapshot's."""
        away = [p - p0 for p, p0 in zip(position_mm, self.reference_mm, strict=True)]
        x, y, z = (
            k0 + sum(slope * distance for slope, distance in zip(row, away, strict=True))
            for k0, row in zip(self.k0_um, self.slope_um_per_mm, strict=True)
        )
        return x, y, z


class NotSendable(ValueError):
    """Offsets that a driver never sends: not finite, or too large. Raised before anything is sent."""


class NumericalControl(Protocol):
    """Any control. Raises drivers.base.DriverError; never retries. Every number is finite, but results of a cycle."""

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def snapshot(self) -> NcSnapshot: ...

    async def request_probing(self, number: int) -> None:
        """Ask for a cycle, which the control begins at its next safe point, never in a cut.

        `number` must differ from the last one, so an old result is never taken for a new one. Raises Refused while
        another request waits that was not withdrawn, or a cycle is under way: whose they are the control does not know.
        """
        ...

    async def probing_status(self, number: int) -> ProbingStatus: ...

    async def withdraw_probing(self, number: int) -> None: ...

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Set the tool-centre-point shift (X, Y, Z) in µm that the control shall add. Acts at once.

        Raises NotSendable.
        """
        ...

    async def read_compensation(self) -> tuple[float, float, float]:
        """The offsets that the control has in force, µm."""
        ...

    async def claim(self, owner: int, terms: WatchdogTerms) -> None:
        """Become the one gateway that writes offsets, and tell the control's watchdog what to do on silence.

        Raises Refused while another owner's heartbeat is alive.
        """
        ...

    async def heartbeat(self, owner: int) -> bool:
        """Tell the control that the gateway is alive.

        False: its watchdog was not watching until this beat (it found the gateway silent, it was switched on, or it is
        missing): the offsets may have moved, so nothing may be written until they are read and a later beat is True.
        Raises Refused when the control belongs to another owner.
        """
        ...

    async def release(self, owner: int) -> None:
        """Release the control; its watchdog then does at once what it does on silence. Another owner's claim stays."""
        ...


@runtime_checkable
class FollowsPosition(NumericalControl, Protocol):
    """A control that adds offsets depending on the position by itself, in every cycle of its own."""

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        """(shifted axis, axis whose position counts) of each slope it can have; X, Y, Z are 0, 1, 2."""
        ...

    @property
    def reference_mm(self) -> Triple:
        """P0 of X, Y, Z, counted as a snapshot's positions."""
        ...

    @property
    def reach_mm(self) -> Triple:
        """How far X, Y, Z can be from their reference."""
        ...

    async def write_linear(self, offsets: LinearOffsets) -> None:
        """Set K0 and slopes. Acts at once; while it is under way any mixture of old and new may be in force.

        Raises NotSendable.
        """
        ...

    async def read_linear(self) -> LinearOffsets:
        """K0 and slopes that the control has in force, about `reference_mm`."""
        ...


def check_number(number: int, what: str) -> None:
    """Raises ValueError for a request or an owner outside 1 .. 2**31 - 1."""
    if not 1 <= number <= LARGEST_NUMBER:
        raise ValueError(f"{what} = {number!r}: expected 1 to {LARGEST_NUMBER}")


def check_offsets(offsets_um: Triple, largest_um: float) -> None:
    """Before anything is sent: raises NotSendable for a number that is not finite or beyond `largest_um`."""
    if not all(math.isfinite(v) for v in offsets_um):
        raise NotSendable(f"offsets_um = {offsets_um!r}: expected three finite numbers; nothing was sent")
    if any(abs(v) > largest_um for v in offsets_um):
        raise NotSendable(f"offsets_um = {offsets_um!r}: beyond largest_um = {largest_um:g}; nothing was sent")
