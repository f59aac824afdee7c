"""Decides when to request a wanted measurement, given what the machine does. Pure: time is an argument.

The request itself is an offer: the control begins the cycle at its next safe point, between two operations, never in a
cut. Here only the time of the offer is decided, so that probing costs as little of a program's time as possible.

state        leaves when                                                                      to
not_wanted   the controller wants a measurement                                               waiting or blocked
waiting      the moment is good enough, or the request is urgent or old                       due
blocked      alarm, control or its mode, connection, or the pause after rejected results is over   waiting
due          the caller has asked the control                                                 asked
asked        the cycle has ended                                                              as the result is
any but asked: the controller no longer wants a measurement                                   not_wanted

A person's command wants one too, whatever the controller does: it is urgent, and for one request. A new reference stays
wanted until it is measured, and only while no program runs: from then on the offsets go to another place.
"""

from enum import StrEnum

import numpy as np

from drivers.nc import NcSnapshot, OperatingMode, ProgramState
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.probing import End, Outlook
from gateway.model.standing import Standing
from gateway.model.text import NOTHING, Text
from gateway.model.wording import event_of
from talc.frame import Decision, Event, EventKind, Why
from talc.indicators import TWO_SIDED_95

URGENT = frozenset({Why.CALIBRATION, Why.NO_GOOD, Why.RETRY, Why.COMMAND})
"""Reasons that belong to the next grid step and do not wait for a better moment."""
_SPEEDS = ("spindle_speed", "speed_X", "speed_Y", "speed_Z", "speed_A", "speed_C")
_STILL = 1e-3
"""Speeds below this (1/min, mm/min) count as standstill."""
_RUNS = frozenset({ProgramState.RUNNING, ProgramState.WAITING})
"""A program that waits for another channel or axis goes on by itself."""


class Moment(StrEnum):
    """How suitable the present moment is, from bad to good."""

    CUT = "in a cut"
    TOOL_CHANGE = "tool change"
    PROGRAM_END = "program end"
    IDLE = "idle"


def moment(before: NcSnapshot | None, now: NcSnapshot) -> Moment:
    """The moment of `now`; `before` is the previous snapshot, which shows changes.

    A program that is interrupted or stopped with something still turning counts as a cut, and so does a speed that the
    control reports in a form that cannot be read.
    """
    turning = any(name in now.not_known or abs(now.states.get(name, 0.0)) > _STILL for name in _SPEEDS)
    if now.program in _RUNS:
        changed = before is not None and before.tool is not None and now.tool is not None and now.tool != before.tool
        return Moment.TOOL_CHANGE if changed else Moment.CUT
    if turning or now.program in (ProgramState.INTERRUPTED, ProgramState.UNKNOWN):
        return Moment.CUT
    if before is not None and before.program in _RUNS:
        return Moment.PROGRAM_END
    return Moment.IDLE


def excess(decision: Decision) -> float:
    """The largest uncertainty (95 %) of an estimate, as a multiple of its limit; 0: no error has both."""
    ratios = TWO_SIDED_95 * decision.sigma / decision.limits
    return float(np.max(ratios, initial=0.0, where=np.isfinite(ratios)))


class ProbingSchedule:
    """Delays a wanted measurement until the moment suits the machine.

    prefer_idle_s: a routine request waits this long for an idle machine or the end of a program; then a tool
        change is good enough
    insist_after_s: after this it is requested whatever the program does, and the operator is informed; a command that
        was blocked for this long is dropped
    urgent_excess: nor does it wait while an uncertainty is more than this many times as large as its limit
    retries: rejected results are requested again at most this many times in a row
    pause_s: then nothing is requested for this long
    """

    def __init__(
        self, *, prefer_idle_s: float, insist_after_s: float, urgent_excess: float, retries: int, pause_s: float
    ) -> None:
        if not 0 <= prefer_idle_s <= insist_after_s:
            raise ValueError(
                f"prefer_idle_s = {prefer_idle_s!r}, insist_after_s = {insist_after_s!r}: expected 0 <= first <= second"
            )
        if retries < 0 or not pause_s >= 0:
            raise ValueError(f"retries = {retries!r}, pause_s = {pause_s!r}: expected 0 or more")
        self._prefer_idle, self._insist_after = prefer_idle_s, insist_after_s
        self._urgent_excess, self._excess = urgent_excess, 0.0
        self._retries, self._pause = retries, pause_s
        self._why: Why | None = None
        self._since = 0.0
        self._ordered_s: float | None = None
        """When a person asked for a measurement that has not ended yet."""
        self._anew = False
        """Whether a new reference is wanted."""
        self._before: NcSnapshot | None = None
        self._asked = False
        self._refused = NOTHING
        self._rejected = 0
        self._paused_until: float | None = None
        self._operator = NOTHING

    @property
    def wanted(self) -> bool:
        """Whether a measurement is wanted and not yet requested."""
        return self._reason is not None and not self._asked

    @property
    def _reason(self) -> Why | None:
        if self._anew:
            return Why.REFERENCE
        return self._why if self._ordered_s is None else Why.COMMAND

    @property
    def _urgent(self) -> bool:
        return self._reason in URGENT or bool(self._rejected) or self._excess > self._urgent_excess

    def want(self, why: Why | None, now_s: float, excess: float = 0.0) -> None:
        """The controller's request from now on; None: none. One that only changes its reason keeps waiting.

        excess: of its decision
        """
        if not self._anew and (why is None or self._why is None):
            self._since = now_s
            self._operator = NOTHING
        if self._without(why) and not self._asked and self._paused_until is None:
            self._rejected, self._refused = (
                0,
                NOTHING,
            )  # the next request is a new one, not a repeat of what was rejected
        self._why, self._excess = why, excess

    def order(self, now_s: float) -> None:
        """A person asks for a measurement now. It ends the pause after rejected results, whose cause is known to them.

        While one is asked for, this changes nothing.
        """
        if not self._asked:
            self._ordered_s = now_s
            self._paused_until, self._rejected, self._refused, self._operator = None, 0, NOTHING, NOTHING

    def renew(self, now_s: float) -> None:
        """A new reference is wanted until it is measured. It ends the pause after rejected results."""
        self._anew, self._since = True, now_s
        self._paused_until, self._rejected, self._refused, self._operator = None, 0, NOTHING, NOTHING

    def look(self, snapshot: NcSnapshot | None, now_s: float, barrier: Text = NOTHING) -> Outlook:
        """Judge the present moment.

        snapshot: the latest; None: the control cannot be reached
        barrier: why no cycle may be requested at all, before a dry run
        """
        before, self._before = self._before, snapshot
        if self._reason is None or self._asked:
            return self._outlook(Standing.ASKED if self._asked else Standing.NOT_WANTED)
        late = now_s - self._since >= self._insist_after
        blocked = self._blocked(snapshot, now_s, barrier)
        if self._ordered_s is not None and blocked and now_s - self._ordered_s >= self._insist_after:
            return self._dropped(blocked)
        if blocked or snapshot is None:
            if late and not self._operator:
                self._operator = Text(NoticeCode.NO_MEASUREMENT_FOR, minutes=self._insist_after / 60, reason=blocked)
            return self._outlook(Standing.BLOCKED, blocked)
        if self._paused_until is not None:
            self._paused_until, self._rejected, self._operator = None, 0, NOTHING
        return self._free(moment(before, snapshot), self._reason, now_s - self._since)

    def _free(self, here: Moment, why: Why, waited_s: float) -> Outlook:
        """Judge a moment at which nothing blocks what is wanted."""
        idle, late = here in (Moment.IDLE, Moment.PROGRAM_END), waited_s >= self._insist_after
        waits_idle, minutes = Text(NoticeCode.WAITS_IDLE), self._insist_after / 60
        if idle or (self._urgent and not self._anew):
            return self._outlook(Standing.DUE)
        if self._anew:
            if late:
                self._operator = Text(NoticeCode.NO_MEASUREMENT_FOR, minutes=minutes, reason=waits_idle)
            return self._outlook(Standing.WAITING, waits_idle)
        if late:
            self._operator = Text(NoticeCode.MEASUREMENT_WAITED, why=why.value, minutes=minutes)
            return self._outlook(Standing.DUE)
        if waited_s < self._prefer_idle:
            return self._outlook(Standing.WAITING, waits_idle)
        if here is Moment.TOOL_CHANGE:
            return self._outlook(Standing.DUE)
        return self._outlook(Standing.WAITING, Text(NoticeCode.WAITS_TOOL_CHANGE))

    def asked(self) -> Why:
        """The control is being asked; returns the reason. Raises ValueError if nothing is wanted."""
        if (reason := self._reason) is None:
            raise ValueError("nothing is wanted")
        self._asked, self._refused = True, NOTHING
        return Why.RETRY if self._rejected and not self._anew else reason

    def ended(self, end: End, reason: Text, now_s: float) -> Outlook:
        """The request has ended; `reason` says why there is no result.

        The wanted measurement is fulfilled, or stays wanted: the controller renews or drops it.
        """
        self._asked, self._ordered_s = False, None
        match end:
            case End.MEASURED:
                self._anew, self._why, self._rejected, self._refused, self._operator = False, None, 0, NOTHING, NOTHING
                return self._outlook(Standing.NOT_WANTED)
            case End.REFUSED:
                self._refused = reason
            case End.REJECTED:
                self._rejected += 1
                self._refused = reason
                if self._rejected > self._retries:
                    self._paused_until = now_s + self._pause
                    self._operator = Text(NoticeCode.CLEAN_SPHERE, n=self._rejected, reason=reason)
                    # The cause of failing results outlasts one request.
                    return self._without_result(Standing.BLOCKED, self._blocked_by_rejects())
                return self._without_result(Standing.WAITING, Text(NoticeCode.REQUESTED_AGAIN, reason=reason))
        return self._without_result(Standing.BLOCKED, reason)

    def _dropped(self, blocked: Text) -> Outlook:
        """A command could not be obeyed in time: nobody expects the machine to probe so much later."""
        self._ordered_s = None
        text = Text(NoticeCode.COMMAND_NOT_POSSIBLE, minutes=self._insist_after / 60, reason=blocked)
        standing = Standing.NOT_WANTED if self._why is None else Standing.BLOCKED
        return Outlook(standing, self._why, blocked if self._why is not None else NOTHING, self._rejected, text)

    def _without_result(self, standing: Standing, reason: Text) -> Outlook:
        """The state after a request without a result; it may have been dropped meanwhile."""
        if not self._without(self._why):
            return self._outlook(standing, reason)
        if self._paused_until is None:
            self._rejected, self._refused = 0, NOTHING
        return self._outlook(Standing.NOT_WANTED)

    def _without(self, why: Why | None) -> bool:
        """Whether nothing is wanted if the controller wants this, but for a person's command."""
        return why is None and not self._anew

    def _blocked(self, snapshot: NcSnapshot | None, now_s: float, barrier: Text) -> Text:
        if snapshot is None:
            return Text(NoticeCode.NC_UNREACHABLE)
        if barrier:
            return barrier
        if snapshot.alarms:
            return Text(NoticeCode.NC_ALARM, numbers=tuple(map(str, snapshot.alarms)))
        if snapshot.cannot_probe:
            return Text(NoticeCode.NC_CANNOT_PROBE, reason=snapshot.cannot_probe, code=snapshot.cannot_probe_code)
        # The control checks its mode itself when it answers; an unreported mode is no reason to wait.
        if snapshot.cannot_probe is None and snapshot.mode not in (OperatingMode.AUTO, OperatingMode.UNKNOWN):
            return Text(NoticeCode.NC_OTHER_MODE, mode=snapshot.mode.value.upper())
        if self._paused_until is not None and now_s < self._paused_until:
            return self._blocked_by_rejects()
        return NOTHING

    def _blocked_by_rejects(self) -> Text:
        return Text(NoticeCode.PAUSE_AFTER_REJECTS, n=self._rejected, reason=self._refused)

    def _outlook(self, standing: Standing, reason: Text = NOTHING) -> Outlook:
        why = self._reason
        if self._rejected and why is not None and not self._anew:
            why = Why.RETRY
        return Outlook(standing, why, reason, self._rejected, self._operator)


def schedule_of(probing: Probing) -> ProbingSchedule:
    """With the limits of a configuration."""
    return ProbingSchedule(
        prefer_idle_s=probing.prefer_idle_s,
        insist_after_s=probing.insist_after_s,
        urgent_excess=probing.urgent_excess,
        retries=probing.retries,
        pause_s=probing.pause_s,
    )


class Bulletin:
    """Messages about the outlooks, each once while it lasts."""

    def __init__(self) -> None:
        self._problem = self._operator = NOTHING

    def of(self, outlook: Outlook) -> tuple[Event, ...]:
        """What is new in this outlook."""
        events = []
        blocked = outlook.reason if outlook.standing is Standing.BLOCKED else NOTHING
        over = outlook.standing in (Standing.WAITING, Standing.NOT_WANTED)
        if self._problem and (over or blocked not in (NOTHING, self._problem)):
            # The cause may well last after the measurement is no longer wanted.
            moot = outlook.standing is Standing.NOT_WANTED
            code = NoticeCode.PROBING_MOOT if moot else NoticeCode.PROBING_FREE
            events.append(event_of(EventKind.PROBLEM_ENDED, Text(code, reason=self._problem)))
            self._problem = NOTHING
        if blocked and blocked != self._problem:
            events.append(event_of(EventKind.PROBLEM, Text(NoticeCode.PROBING_BLOCKED, reason=blocked)))
            self._problem = blocked
        if outlook.operator not in (NOTHING, self._operator):
            events.append(event_of(EventKind.OPERATOR, outlook.operator))
        self._operator = outlook.operator
        return tuple(events)
