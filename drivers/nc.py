"""The interface of numerical controls. Units are the NC's, mm and degrees; offsets are in µm."""

import math
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Final, Protocol, runtime_checkable

from drivers.base import Quality
from drivers.text import Text

Triple = tuple[float, float, float]
"""X, Y, Z."""

LINEAR_AXES = ("X", "Y", "Z")
ROTARY_AXES = ("A", "C")
AXES = LINEAR_AXES + ROTARY_AXES
ERRORS: Final = 9
"""Number of thermal errors."""
FARTHEST_MM: Final = 1e5
"""No linear axis is longer; what lies beyond is not a position."""
LARGEST_UM: Final = 500.0
"""Larger offsets are never sent to a control, unless its settings say otherwise."""
REQUEST_VALID_FOR_S: Final = 900.0
"""For so long a request for a probing cycle waits for a safe point, unless the settings say otherwise."""
LEAST_HEIGHT_MM: Final = 20.0
"""Nothing lower is asked for: with the supplied programs a touch goes 19 mm down from where the sphere is touched."""
LARGEST_HEIGHT_MM: Final = 1000.0
"""No dry run is higher above the sphere."""
LARGEST_NUMBER: Final = 2**31 - 1
"""Largest request or owner number that a control stores exactly, both as an integer and as a floating-point number."""


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
    """The operating mode that the operator has selected."""

    JOG = "jog"
    MDA = "mda"
    AUTO = "auto"
    UNKNOWN = "unknown"


class ProgramState(StrEnum):
    """The state of the part program."""

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
    """UTC at which it was read."""
    monotonic_s: float
    positions: dict[str, float]
    """Axis name to actual position: X Y Z in mm relative to where A and C meet, A C in degrees."""
    states: dict[str, float] = field(default_factory=dict)
    """Machine states that models use: spindle_speed (1/min), speed_X .. speed_C (mm/min, 1/min), coolant (0/1).

    States without a good value are missing."""
    mode: OperatingMode = OperatingMode.UNKNOWN
    program: ProgramState = ProgramState.UNKNOWN
    tool: int | None = None
    """Number of the tool in the spindle; None: not known."""
    probe_in_spindle: bool | None = None
    alarms: tuple[int, ...] = ()
    """Numbers of the first few active alarms."""
    ready: bool | None = None
    """False: emergency stop, drives off or an axis not referenced. An offset written now may have no effect, or take
    effect later all at once. None: the control does not report it."""
    cannot_probe: str | None = None
    """Why no cycle can begin in the control's present state; empty if one can: in any mode, in a part program at its
    next safe point. None: the control does not report it, and cycles begin in AUTO only."""
    probing: bool | None = None
    """Whether a probing cycle is in progress, no matter who requested it; None: the control does not report it."""
    quality: Quality = Quality.GOOD
    not_known: dict[str, str] = field(default_factory=dict)
    """Name of a state, or of a field above, to what the control reports of it and the driver cannot read. The state is
    missing, and the field unknown."""
    cannot_probe_code: str = ""
    """`cannot_probe` for programs; empty: the control gives none."""


@dataclass(frozen=True, slots=True)
class RequestStatus:
    """State of the cycle of request `number`."""

    number: int
    state: ProbingState
    centres_mm: tuple[tuple[float, float, float], ...] | None = None
    """When done: the measured centre of the sphere at each pose (X, Y, Z)."""
    reason: str = ""
    """Why it was refused or failed, in words."""
    spread_mm: float | None = None
    """When done: largest difference between repeated touches of one point; None: the control does not report it."""
    in_force_um: Triple | None = None
    """When done: the shift of X, Y, Z that stood still while it ran; None: what the gateway had written."""
    code: str = ""
    """`reason` for programs; empty: the control gives none."""


@dataclass(frozen=True, slots=True)
class WatchdogTerms:
    """What the control's watchdog does when the gateway falls silent. Raises ValueError for an invalid field."""

    silence_s: float
    """After this time without a heartbeat the gateway is considered dead."""
    ramp_um_per_s: float
    """Rate at which the offsets then return to zero; 0 holds them."""
    slew_um_per_s: float | None = None
    """Rate that the configuration declares, for a control that slews by itself; None: not told."""

    def __post_init__(self) -> None:
        if not 0 < self.silence_s < math.inf:
            raise ValueError(f"silence_s = {self.silence_s!r}: expected more than 0")
        if not 0 <= self.ramp_um_per_s < math.inf:
            raise ValueError(f"ramp_um_per_s = {self.ramp_um_per_s!r}: expected 0 or more")


@dataclass(frozen=True, slots=True)
class LinearOffsets:
    """A shift of the tool that depends on the position of the linear axes: K0 + tanβ (P - P0)."""

    k0_um: Triple
    """Shift of X, Y, Z when every axis is at its reference."""
    slope_um_per_mm: tuple[Triple, Triple, Triple]
    """Row: shifted axis; column: axis whose position counts."""
    reference_mm: Triple
    """P0 of X, Y, Z, in the coordinates of a snapshot's positions."""

    def at(self, position_mm: Triple) -> Triple:
        """Shift of X, Y, Z in µm at a position in a snapshot's coordinates."""
        away = [p - p0 for p, p0 in zip(position_mm, self.reference_mm, strict=True)]
        x, y, z = (
            k0 + sum(slope * distance for slope, distance in zip(row, away, strict=True))
            for k0, row in zip(self.k0_um, self.slope_um_per_mm, strict=True)
        )
        return x, y, z


@dataclass(frozen=True, slots=True)
class NineErrors:
    """Thermal errors for a control that computes the offsets itself; see talc.kinematics."""

    errors: tuple[float, ...]
    """Nine in the order of THERMAL_ERRORS, µm and µm/m."""
    radius_mm: float
    """Radius at which ER0T is."""
    bound_um: Triple
    """Largest offset of X, Y, Z, wherever the tool is."""


class NotSendable(ValueError):
    """Offsets that a driver never sends: not finite, or too large. Raised before anything is sent."""


class NumericalControl(Protocol):
    """Any control. Raises drivers.base.DriverError; a call that failed is not repeated. Every number is finite except a
    cycle's results."""

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def snapshot(self) -> NcSnapshot: ...

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        """Request a cycle, which the control begins at its next safe point, never in a cut.

        `number` must differ from the last one, so that an old result is never taken for a new one. Raises Refused while
        another request waits (unless withdrawn) or a cycle is in progress: the control does not know which gateway
        asked.

        dry_run_mm: above 0, a dry run: the control follows the cycle's path raised by this height, at reduced feed and
        without touching. When done, `centres_mm` are the positions that it reached, one for each pose. Raises Refused
        before anything is asked, unless the control RunsDry.
        """
        ...

    async def probing_status(self, number: int) -> RequestStatus: ...

    async def withdraw_probing(self, number: int) -> None: ...

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Set the tool-centre-point shift (X, Y, Z) in µm that the control shall add. Acts at once.

        Raises NotSendable.
        """
        ...

    async def read_compensation(self) -> tuple[float, float, float]:
        """The offsets in force on the control, µm."""
        ...

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Become the only gateway that writes offsets, and tell the control's watchdog what to do on silence.

        Raises Refused while another owner's heartbeat is alive, apart from the predecessor's: its claim ends.
        """
        ...

    async def heartbeat(self, owner: int) -> bool:
        """Tell the control that the gateway is alive.

        Returns False if the control's watchdog was not active before this beat (it found the gateway silent, was just
        switched on, or is missing): the offsets may have moved, so nothing may be written until they have been read and
        a later beat returns True. Raises Refused when the control belongs to another owner.
        """
        ...

    async def release(self, owner: int) -> None:
        """Release the control; its watchdog then does at once what it does on silence. Another owner's claim stays."""
        ...


class TakesSlopes(Protocol):
    """Position-dependent offsets of a control that adds them by itself, in each of its own cycles."""

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        """(shifted axis, axis whose position counts) of each slope it can have; X, Y, Z are 0, 1, 2."""
        ...

    @property
    def reference_mm(self) -> Triple:
        """P0 of X, Y, Z, in the coordinates of a snapshot's positions."""
        ...

    @property
    def reach_mm(self) -> Triple:
        """Largest distance of X, Y, Z from their reference."""
        ...

    async def write_linear(self, offsets: LinearOffsets) -> None:
        """Set K0 and slopes. Acts at once; while it is under way any mixture of old and new may be in force.

        Raises NotSendable.
        """
        ...

    async def read_linear(self) -> LinearOffsets:
        """K0 and slopes in force on the control, relative to `reference_mm`."""
        ...


@runtime_checkable
class FollowsPosition(NumericalControl, TakesSlopes, Protocol):
    """A control that takes slopes, known before it is connected."""


@runtime_checkable
class FollowsErrors(NumericalControl, Protocol):
    """A control that may work out the offsets from the nine errors and from where its tool is, in its own cycles."""

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        """Farthest that a tool's tip gets from where A and C meet, along X and across it.

        Known once connected; None: this control does not take the nine errors.
        """
        ...

    @property
    def slopes(self) -> TakesSlopes | None:
        """How it takes slopes, where it does not take the nine errors. Known once connected; None: only shifts."""
        ...

    async def write_errors(self, errors: NineErrors) -> None:
        """Set what shall be in force, slewed by the control.

        Raises NotSendable.
        """
        ...

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        """The nine errors in force; ER0T at `radius_mm`."""
        ...


@runtime_checkable
class RunsDry(Protocol):
    """A control whose probing program may know dry runs."""

    @property
    def runs_dry(self) -> bool | None:
        """Whether it does, by what it showed last: at `connect`, or at the latest snapshot. None: not shown yet."""
        ...


@runtime_checkable
class MarksPath(Protocol):
    """A control that tells when what its probing cycle is made of has changed: places, clearances, feeds."""

    @property
    def path_mark(self) -> str:
        """The same for the same path alone; empty: it does not tell. Known once connected."""
        ...


@runtime_checkable
class ForgetsWrites(Protocol):
    """A control that refuses what reaches it too late."""

    @property
    def late_write_s(self) -> float:
        """How long a write without an answer may still take effect, s. Known once connected."""
        ...


@runtime_checkable
class TriesWriting(Protocol):
    """A control on which it can be tried whether this gateway may write, without changing anything."""

    async def try_writing(self) -> None:
        """Write back what is there: all that claim, heartbeat, request and offsets need.

        Raises Refused naming what may not be written, and while another gateway's heartbeat is alive.
        """
        ...


def check_number(number: int, what: str) -> None:
    """Raises ValueError for a request or an owner outside 1 .. 2**31 - 1."""
    if not 1 <= number <= LARGEST_NUMBER:
        raise ValueError(f"{what} = {number!r}: expected 1 to {LARGEST_NUMBER}")


def check_height(dry_run_mm: float) -> None:
    """Raises ValueError for the height of a dry run outside 0 .. 1000 mm."""
    if not 0 <= dry_run_mm <= LARGEST_HEIGHT_MM:
        raise ValueError(f"dry_run_mm = {dry_run_mm!r}: expected 0 to {LARGEST_HEIGHT_MM:g}")


def check_errors(errors: NineErrors, largest_um: float) -> None:
    """Before anything is sent: raises NotSendable for a number that is not finite or beyond `largest_um`."""
    if len(errors.errors) != ERRORS or not all(
        map(math.isfinite, (*errors.errors, errors.radius_mm, *errors.bound_um))
    ):
        raise NotSendable(Text("nc_errors_not_finite", errors=repr(errors)))
    if any(abs(v) > largest_um for v in errors.errors):
        raise NotSendable(Text("nc_errors_beyond", errors=repr(errors.errors), most_um=largest_um))


def check_offsets(offsets_um: Triple, largest_um: float) -> None:
    """Before anything is sent: raises NotSendable for a number that is not finite or beyond `largest_um`."""
    if not all(math.isfinite(v) for v in offsets_um):
        raise NotSendable(Text("nc_offsets_three", offsets=repr(offsets_um)))
    if any(abs(v) > largest_um for v in offsets_um):
        raise NotSendable(Text("nc_offsets_beyond", offsets=repr(offsets_um), most_um=largest_um))
