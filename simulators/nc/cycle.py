"""The probing cycle as the part program runs it: a state machine stepped by time, independent of any protocol.

state      leaves when                        to
idle       asked                              waiting, or refused when the control cannot probe
waiting    the next safe point is reached     accepted, or refused / withdrawn / expired
accepted   the probe is over the first pose   running
running    six poses touched, back at first   done, or failed when a touch finds nothing
accepted, running: an alarm, a stop or a withdrawal ends it as failed

A dry run does the same above the sphere: it touches nothing, and its result is where it has been.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

Centre = tuple[float, float, float]


class CycleState(IntEnum):
    """Value of the handshake's state parameter."""

    IDLE = 0
    ACCEPTED = 1
    RUNNING = 2
    DONE = 3
    REFUSED = 4
    FAILED = 5


class ReasonCode(IntEnum):
    """Value of the handshake's reason parameter."""

    NONE = 0
    ALARM = 1
    NO_PROBE = 2
    WRONG_MODE = 3
    WITHDRAWN = 4
    EXPIRED = 5
    NO_CONTACT = 6
    STOPPED = 7


@dataclass(frozen=True, slots=True)
class CycleSettings:
    """Position of the sphere and duration of a cycle (Z22: 120 s, six poses)."""

    poses_deg: tuple[tuple[float, float], ...] = ((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0))
    """A, C of each pose, degrees."""
    radius_mm: float = 120.0
    """Distance of the sphere's centre from the C axis."""
    height_mm: float = 80.0
    """Height of the sphere's centre above the A axis at A = 0."""
    duration_s: float = 120.0
    approach_s: float = 10.0
    """From the safe point until the probe is in the spindle."""
    noise_um: float = 1.0
    """Standard deviation of each coordinate of a measured centre."""

    def nominal_centre_mm(self, pose: int) -> Centre:
        """Where the sphere is at a pose of the ideal machine: Rx(a) Rz(c) (R, 0, h)."""
        a, c = (math.radians(angle) for angle in self.poses_deg[pose])
        x, y, z = self.radius_mm * math.cos(c), self.radius_mm * math.sin(c), self.height_mm
        return x, y * math.cos(a) - z * math.sin(a), y * math.sin(a) + z * math.cos(a)

    def touch_offset_s(self, pose: int) -> float:
        """Time of a pose's touches after the safe point; the rest of the duration takes the probe away."""
        slot = (self.duration_s - 2 * self.approach_s) / len(self.poses_deg)
        return self.approach_s + (pose + 1) * slot


@dataclass(frozen=True, slots=True)
class CycleAnswer:
    """The control's answer to the last request that it processed."""

    number: int
    state: CycleState
    reason: ReasonCode = ReasonCode.NONE
    centres_mm: tuple[Centre, ...] = ()
    raised_mm: float = 0.0
    """Height of a dry run above the sphere; 0: it touches."""


class ProbingCycle:
    """One cycle at a time.

    Parameters
    ----------
    touch: (time_s, pose, raised_mm) -> measured centre in mm, or None when the probe found nothing; raised, it is where
        the tool has been
    next_safe_point: (time_s) -> first time from then on when the program may be interrupted
    """

    def __init__(
        self,
        settings: CycleSettings,
        touch: Callable[[float, int, float], Centre | None],
        next_safe_point: Callable[[float], float],
    ) -> None:
        self._settings = settings
        self._touch = touch
        self.next_safe_point = next_safe_point
        """Next safe point of the program that runs now."""
        self._waiting: tuple[int, float, float] | None = None  # number, expires at, raised by
        self._withdrawn = 0
        """Number of the waiting request that was withdrawn; 0: none."""
        self._due_s = math.inf
        self._pose = 0
        self._centres: list[Centre] = []
        self.started_s: float | None = None
        """Safe point at which the cycle in progress began; None if there is none."""
        self.ended: list[tuple[float, float]] = []
        """Start and end of every cycle that was begun and is over, in order."""
        self.raised_mm: dict[float, float] = {}
        """Start of each dry run to its height above the sphere."""
        self.answer = CycleAnswer(0, CycleState.IDLE)
        self._inhibited = ReasonCode.NONE

    @property
    def next_event_s(self) -> float | None:
        """When `advance` next has something to do; None: not before a request."""
        return self._due_s if math.isfinite(self._due_s) else None

    def ask(self, now_s: float, number: int, valid_for_s: float = math.inf, raised_mm: float = 0.0) -> None:
        """Request cycle `number`, or a dry run; while another is in progress this one waits for its end."""
        self._waiting, self._withdrawn = (number, now_s + valid_for_s, raised_mm), 0
        if self.started_s is None:
            if self._inhibited is not ReasonCode.NONE:
                self._refuse(self._inhibited)
            else:
                self._due_s = self._next_chance(now_s)

    def withdraw(self, now_s: float, number: int) -> None:
        """Withdraw request `number`: a waiting one is refused at its safe point, where the control looks; a cycle in
        progress stops and fails. Other numbers change nothing."""
        if self._waiting is not None and self._waiting[0] == number:
            self._withdrawn = number
        elif self.started_s is not None and self.answer.number == number:
            self.interrupt(now_s, ReasonCode.WITHDRAWN)

    def inhibit(self, now_s: float, reason: ReasonCode) -> None:
        """Forbid probing for a reason (NONE: allow it again): refuses a waiting request, ends a cycle in progress."""
        self._inhibited = reason
        if reason is not ReasonCode.NONE:
            self.interrupt(now_s, reason)
            self._refuse(reason)

    def interrupt(self, now_s: float, reason: ReasonCode) -> None:
        """End the cycle in progress as failed."""
        if self.started_s is not None:
            self._end(now_s, CycleState.FAILED, reason)

    def advance(self, now_s: float) -> None:
        """Process everything that was due until now, in order."""
        while self._due_s <= now_s:
            self._step(self._due_s)

    def _step(self, now_s: float) -> None:
        match self.answer.state:
            case CycleState.ACCEPTED:
                self.answer = replace(self.answer, state=CycleState.RUNNING)
                self._pose, self._centres = 0, []
                self._due_s = self._start + self._settings.touch_offset_s(0)
            case CycleState.RUNNING if self._pose < len(self._settings.poses_deg):
                centre = self._touch(now_s, self._pose, self.answer.raised_mm)
                if centre is None:
                    self._end(now_s, CycleState.FAILED, ReasonCode.NO_CONTACT)
                    return
                self._centres.append(centre)
                self._pose += 1
                last = self._pose == len(self._settings.poses_deg)
                offset = self._settings.duration_s if last else self._settings.touch_offset_s(self._pose)
                self._due_s = self._start + offset
            case CycleState.RUNNING:
                self._end(now_s, CycleState.DONE, ReasonCode.NONE, tuple(self._centres))
            case _:
                self._begin(now_s)

    @property
    def _start(self) -> float:
        return self.started_s if self.started_s is not None else math.nan

    def _begin(self, now_s: float) -> None:
        if self._waiting is None:
            self._due_s = math.inf
            return
        number, expires_s, raised_mm = self._waiting
        if now_s >= expires_s:
            self._refuse(ReasonCode.EXPIRED)
        elif number == self._withdrawn:
            self._refuse(ReasonCode.WITHDRAWN)
        else:
            self._waiting = None
            self.started_s = now_s
            if raised_mm:
                self.raised_mm[now_s] = raised_mm
            self.answer = CycleAnswer(number, CycleState.ACCEPTED, raised_mm=raised_mm)
            self._due_s = now_s + self._settings.approach_s

    def _next_chance(self, now_s: float) -> float:
        expires_s = self._waiting[1] if self._waiting is not None else math.inf
        return min(self.next_safe_point(now_s), expires_s)

    def _refuse(self, reason: ReasonCode) -> None:
        if self._waiting is None:
            return
        refused = CycleAnswer(self._waiting[0], CycleState.REFUSED, reason)
        self._waiting = None
        if self.started_s is None:
            self.answer = refused
            self._due_s = math.inf

    def _end(self, now_s: float, state: CycleState, reason: ReasonCode, centres_mm: tuple[Centre, ...] = ()) -> None:
        self.ended.append((self._start, now_s))
        self.started_s = None
        self.answer = replace(self.answer, state=state, reason=reason, centres_mm=centres_mm)
        self._due_s = self._next_chance(now_s) if self._waiting is not None else math.inf
