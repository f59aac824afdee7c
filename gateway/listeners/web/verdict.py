"""The verdict, ready or not: compares the error that remains at the tool with a tolerance, as far as it is known."""

import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from enum import StrEnum

import numpy as np

from gateway.listeners.web.ahead import (
    Outlook,
    advice,
    ahead,
    cycle_takes,
    cycle_took,
    measures,
    planned,
    planned_ahead,
    when,
)
from gateway.listeners.web.at_tool import ToolError, at_the_tool, course, half_width, told
from gateway.listeners.web.sentences import Amount, Atom, Sentence, ToldName, Word, at, tolerance, um
from gateway.model.control_state import NcState
from gateway.model.standing import Standing
from gateway.telemetry.subscriber.instants import instant
from gateway.telemetry.subscriber.machine import MachineSeen, applied, holds_s, is_old, is_past, nine
from talc.frame import FloatArray, Phase
from talc.kinds import EventCode


class Colour(StrEnum):
    """Colour of the verdict; the page has a word beside each."""

    AWAY = "away"
    """Nothing that is shown is current."""
    RED = "red"
    GREY = "grey"
    AMBER = "amber"
    GREEN = "green"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the machine may cut to a tolerance."""

    colour: Colour
    word: str
    """Key of the catalogue."""
    because: tuple[Sentence, ...] = ()
    since: datetime | None = None
    helps: tuple[Sentence, ...] = ()
    """When it will be ready, and what would help."""
    before: bool = False
    """It was so before `since`, too: nothing earlier is known."""


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """From where a browser looks at one machine."""

    matrix: FloatArray
    """(3, 9) of the chosen place; see gateway.listeners.web.at_tool."""
    tolerance_um: float | None
    """None: none was given."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolNow:
    """The error at the tool now; None where no estimate holds."""

    error: ToolError | None
    old: bool = field(default=False)
    """There is an estimate, but too old."""


def tool_now(seen: MachineSeen, matrix: FloatArray, now_s: float) -> ToolNow:
    """By the latest decision and what the control has in force. Nothing of a gateway that is gone counts as now."""
    if seen.decision is None or not seen.present:
        return ToolNow(None)
    if is_old(seen, now_s):
        return ToolNow(None, old=True)
    errors, sigma = np.array(nine(seen.decision.corrected)), np.array(nine(seen.decision.sigma))
    return ToolNow(at_the_tool(matrix, errors, sigma, applied(seen.compensation)))


def verdict_of(seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> Verdict:
    """The verdict for one browser at this monotonic time."""
    found = judged(seen, viewpoint, now_s)
    if found.word not in _HELPED:
        return found
    since, before = _since(seen, viewpoint, now_s)
    helps = _helps(seen, viewpoint, tool_now(seen, viewpoint.matrix, now_s), ready=found.colour is Colour.GREEN)
    return replace(found, since=since, before=before, helps=tuple(helps))


def judged(seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> Verdict:
    """The same without since when it is so, and without what would help: a fraction of the work."""
    if not seen.present:
        return _absent(seen)
    if seen.decision is None:
        return Verdict(Colour.GREY, "word.no_data", (Sentence("because.no_step"),))
    tool = tool_now(seen, viewpoint.matrix, now_s)
    if tool.old:
        decided = datetime.fromisoformat(seen.decision.time)
        return Verdict(Colour.AWAY, "word.old", (Sentence("because.old", {"at": at(decided)}),), decided)
    if seen.status is not None and seen.status.nc == NcState.PROBING and _asked(seen):
        return _measuring(seen)
    error = tool.error
    if seen.decision.phase == Phase.NO_GOOD:
        return Verdict(Colour.RED, "word.not_ready", (Sentence("because.no_good"),))
    if error is None or not np.isfinite(error.far).all():
        return Verdict(Colour.GREY, "word.unknown", _unknown(seen, error))
    if viewpoint.tolerance_um is None:
        return Verdict(Colour.GREY, "word.no_tolerance", (_left(error), Sentence("because.no_tolerance")))
    colour = _colour(error.near, error.far, viewpoint.tolerance_um)
    said = _left(error) if colour is Colour.GREEN else _order(error, colour, viewpoint.tolerance_um)
    return Verdict(colour, _WORDS[colour], (said, *_all_the_same(seen)))


def _all_the_same(seen: MachineSeen) -> Iterator[Sentence]:
    """What the judgement goes without, a compensation that follows and inputs that have good values; and that the
    machine will be measured soon."""
    if seen.status is not None and (order := seen.status.disarmed or seen.status.paused) is not None:
        key = "because.paused" if seen.status.disarmed is None else "because.disarmed"
        yield Sentence(key, {"at": at(datetime.fromisoformat(order.since))})
    if names := () if seen.decision is None else seen.decision.substituted:
        yield _without(seen, names)
    if _asked(seen):
        yield Sentence("because.asked", {"lasts": cycle_takes(seen)})


def _asked(seen: MachineSeen) -> bool:
    return seen.probing is not None and seen.probing.standing == Standing.ASKED


def _without(seen: MachineSeen, names: Sequence[str]) -> Sentence:
    more, since = len(names) - 1, _missing_since(seen, names)
    values: dict[str, Atom] = {
        "first": ToldName(names[0]),
        "more": Sentence("because.and_more", {"n": Amount(more, d=0)}) if more else ToldName(""),
        "since": ToldName("") if since is None else Sentence("because.since", {"at": at(since)}),
    }
    return Sentence("because.without", values)


def _missing_since(seen: MachineSeen, names: Collection[str]) -> datetime | None:
    """Since when the first of these inputs has been estimated, as far as it was heard."""
    latest = {event.values.get("input"): event.time for event in seen.events if event.code == EventCode.VALUE_ESTIMATED}
    times = [instant(time) for name, time in latest.items() if name in names]
    return min((time for time in times if time is not None), default=None)


def _measuring(seen: MachineSeen) -> Verdict:
    took, since = cycle_took(seen), seen.probing_since
    ends = None if took is None or since is None else at(since + timedelta(seconds=took))
    helps = () if ends is None else (Sentence("when.measured", {"at": ends}),)
    return Verdict(Colour.GREY, "word.probing", (Sentence("because.probing"),), since, helps)


def _left(error: ToolError) -> Sentence:
    worst = int(np.argmax(error.far))
    return Sentence("because.left", {"axis": Word("XYZ"[worst]), "far": um(told(error)[2][worst])})


def _order(error: ToolError, colour: Colour, tolerance_um: float) -> Sentence:
    """Not to cut to this tolerance: which axes exceed it, or may, how far they are off, and what would be met."""
    axes = [i for i, each in enumerate(standings(error, tolerance_um)) if each is colour]
    left, half, far = (np.array(column)[axes] for column in told(error))
    most = float(np.max(told(error)[2]))
    values: dict[str, Atom] = {
        "tolerance": tolerance(tolerance_um),
        "axis": Word(", ".join("XYZ"[i] for i in axes)),
        "near": um(float(np.max(np.abs(left) - half))),
        "far": um(float(np.max(far))),
        "met": tolerance(math.ceil(most)),
    }
    return Sentence("because.exceeds" if colour is Colour.RED else "because.may_exceed", values)


_WORDS = {Colour.GREEN: "word.ready", Colour.AMBER: "word.unsure", Colour.RED: "word.not_ready"}
_HELPED = {*_WORDS.values(), "word.unknown"}
"""For these words it is said since when they hold, and what would help."""


def _colour(near: FloatArray, far: FloatArray, tolerance_um: float) -> Colour:
    """The colour by the (3,) ends of the intervals of what is left; amber if part of one is outside, and never else."""
    if not np.isfinite(far).all():
        return Colour.GREY
    if (far <= tolerance_um).all():
        return Colour.GREEN
    return Colour.RED if (near > tolerance_um).any() else Colour.AMBER


def standings(error: ToolError, tolerance_um: float | None) -> list[Colour]:
    """The colour of each axis by itself."""
    if tolerance_um is None:
        return [Colour.GREY] * 3
    return [_colour(error.near[i : i + 1], error.far[i : i + 1], tolerance_um) for i in range(3)]


def colours_ahead(seen: Outlook, tolerance_um: float) -> Iterator[tuple[Colour, datetime, datetime]]:
    """From when until when the verdict will have which colour."""
    turns = {*seen.crossings(seen.high, tolerance_um), *seen.crossings(seen.near, tolerance_um)}
    times = sorted({seen.at[0], *turns, seen.at[-1]})
    seconds = np.array([time.timestamp() for time in seen.at])
    for begin, end in itertools.pairwise(times):
        middle = (begin + (end - begin) / 2).timestamp()
        near, high = (np.interp([middle], seconds, column) for column in (seen.near, seen.high))
        yield _colour(near, high, tolerance_um), begin, end


def colours(seen: MachineSeen, past: ToolError, tolerance_um: float) -> list[Colour]:
    """The colour of each estimate; past: the errors at the tool at these times."""
    return [
        Colour.RED if e.no_good else _colour(near, far, tolerance_um)
        for e, near, far in zip(seen.estimates, past.near, past.far, strict=True)
    ]


def _absent(seen: MachineSeen) -> Verdict:
    if seen.heard is None:
        return Verdict(Colour.AWAY, "word.never", (Sentence("because.never"), Sentence("do.start")))
    if seen.alive and seen.two:
        return Verdict(Colour.AWAY, "word.no_data", (Sentence("because.two"), Sentence("do.rename")))
    if seen.silent:
        said = Sentence("because.silent", {"heard": at(seen.heard)})
        return Verdict(Colour.AWAY, "word.silent", (said, Sentence("do.restart"), _offsets(seen)), seen.heard)
    gone = seen.gone or seen.heard
    said = Sentence("because.gone", {"at": at(gone)})
    return Verdict(Colour.AWAY, "word.gone", (said, Sentence("do.start"), _offsets(seen)), gone)


def _offsets(seen: MachineSeen) -> Sentence:
    """What becomes of those in force, as far as the gateway has told."""
    match None if seen.status is None else seen.status.when_stale:
        case "zero":
            return Sentence("do.taken_back")
        case "hold":
            return Sentence("do.held")
        case _:
            return Sentence("do.away")


def _unknown(seen: MachineSeen, error: ToolError | None) -> tuple[Sentence, ...]:
    """Why there is no interval."""
    now = applied(seen.compensation)
    bounded = now.bounded
    if math.isnan(now.offsets_um[0]):
        return (Sentence("because.not_taken"),)
    if error is not None and np.isfinite(error.without).all() and any(bounded):
        axes = ", ".join(axis for axis, at_bound in zip("XYZ", bounded, strict=True) if at_bound)
        return (Sentence("because.bounded", {"axes": Word(axes)}),)
    if seen.measurements or seen.last_measurement is not None:
        return (Sentence("because.no_estimate"),)
    return (Sentence("because.no_measurement"),)


def _since(seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> tuple[datetime | None, bool]:
    """The time of the first estimate of those in a row that say the same as the latest, and whether that is the first
    of all. After a time without estimates, or in which the gateway was away, a new row begins."""
    if viewpoint.tolerance_um is None or not seen.estimates:
        return None, False
    past = course(viewpoint.matrix, seen.estimates)
    said = [
        (colour, e.no_good or bool(np.isfinite(far).all()))
        for colour, e, far in zip(colours(seen, past, viewpoint.tolerance_um), seen.estimates, past.far, strict=True)
    ]
    times, longest = [e.at for e in seen.estimates], timedelta(seconds=holds_s(seen))
    first = len(said) - 1
    while (
        first > 0
        and said[first - 1] == said[-1]
        and not seen.estimates[first].anew
        and times[first] - times[first - 1] <= longest
    ):
        first -= 1
    back = seen.back(now_s)
    if back is not None and back > times[first]:
        return back, False
    return times[first], first == 0


def _helps(seen: MachineSeen, viewpoint: Viewpoint, tool: ToolNow, *, ready: bool) -> Iterator[Sentence]:
    """When it will be ready or how long it stays so, what would help more, and when the next measurement comes.

    While somebody has paused the compensation, nothing helps as much as ending the pause, and a gateway that does not
    measure, as it is disarmed or not armed, says nothing of measurements.
    """
    coming, tolerance_um = ahead(seen, viewpoint.matrix), viewpoint.tolerance_um
    disarmed = seen.status is not None and seen.status.disarmed is not None
    ordered = disarmed or (seen.status is not None and seen.status.paused is not None)
    if tolerance_um is not None:
        if not ordered:
            takes = cycle_takes(seen) if measures(seen) else None
            yield from advice(tool.error, coming, tolerance_um, takes, ready=ready)
        yield from when(tool.error, coming, tolerance_um, ready=ready)
        yield from planned(tool.error, planned_ahead(seen, viewpoint.matrix), tolerance_um, ready=ready)
    if ready or disarmed or not measures(seen):
        return
    if coming is None and not ordered and seen.measurements and tolerance_um is not None:
        half = float(np.max(half_width(viewpoint.matrix, np.array(seen.measurements[-1].sigma))))
        if np.isfinite(half):
            key = "help.measure" if half <= tolerance_um else "help.measure_not_enough"
            yield Sentence(key, {"half": um(half), "lasts": cycle_takes(seen)})
    expected = None if seen.reasons is None else seen.at_k(seen.reasons.next_k)
    if seen.reasons is not None and expected is not None and not is_past(seen, expected):
        values: dict[str, Atom] = {"at": at(expected), "why": Word(f"why.{seen.reasons.next_why}")}
        yield Sentence("when.next_measurement", values)
