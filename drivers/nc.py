"""What every numerical control is to the gateway. The NC's own units: mm and degrees; offsets in µm."""

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Protocol

from drivers.base import Quality

LINEAR_AXES = ("X", "Y", "Z")
ROTARY_AXES = ("A", "C")


class ProbingState(StrEnum):
    """The handshake of one probing cycle, as seen by who asked."""

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
    """Axis name to actual position: X Y Z in mm, A C in degrees."""
    states: dict[str, float] = field(default_factory=dict)
    """Machine states that models use: spindle_speed (1/min), speed_X .. speed_C (mm/min, 1/min), coolant (0/1).

    A state that the control gave no good value for is missing."""
    mode: OperatingMode = OperatingMode.UNKNOWN
    program: ProgramState = ProgramState.UNKNOWN
    tool: int | None = None
    """Number of the tool in the spindle; None: not known."""
    probe_in_spindle: bool | None = None
    alarms: tuple[int, ...] = ()
    """Numbers of the alarms that are shown, the first few of them."""
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


class NumericalControl(Protocol):
    """Any control. Raises drivers.base.DriverError; never retries."""

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def snapshot(self) -> NcSnapshot: ...

    async def request_probing(self, number: int) -> None:
        """Ask for a cycle; `number` must differ from the last one, so an old result is never taken for a new one."""
        ...

    async def probing_status(self, number: int) -> ProbingStatus: ...

    async def withdraw_probing(self, number: int) -> None: ...

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Set the tool-centre-point shift (X, Y, Z) in µm that the control shall add. Acts at once."""
        ...

    async def read_compensation(self) -> tuple[float, float, float]:
        """The offsets that the control has in force, µm."""
        ...
