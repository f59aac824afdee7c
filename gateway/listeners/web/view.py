"""A browser's view of one machine or of all, made from the received messages for a given time."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from gateway.listeners.web import parts
from gateway.listeners.web.ahead import ahead, outlook
from gateway.listeners.web.at_tool import ToolError, course, moved, told
from gateway.listeners.web.past import ShownPast, columns
from gateway.listeners.web.scenario import ShownBranch, branches
from gateway.listeners.web.sentences import Amount, SaidRow, Sentence, ToldName, Word, at, in_each, um
from gateway.listeners.web.verdict import (
    Verdict,
    Viewpoint,
    colours,
    colours_ahead,
    judged,
    standings,
    tool_now,
    verdict_of,
)
from gateway.listeners.web.waiting import cost_of_waiting
from gateway.telemetry.subscriber.machine import MachineSeen, applied, is_old, nine
from talc.names import THERMAL_ERRORS

_MOST_CHAIN = 100


@dataclass(frozen=True, slots=True)
class ShownVerdict:
    """Part 1."""

    colour: str
    word: str
    because: tuple[Sentence, ...]
    since: str | None
    before: bool
    """Whether it was so before `since`, too."""
    helps: tuple[Sentence, ...]
    failed: Sentence | None
    """Channels without a good value."""


@dataclass(frozen=True, slots=True)
class ShownAxis:
    """Part 2, one axis at the chosen point; a number that is null is unknown."""

    axis: str
    without: Amount
    left: Amount
    half: Amount
    far: Amount
    in_force: Amount
    colour: str
    """The verdict's, of this axis alone."""


@dataclass(frozen=True, slots=True)
class MachineView:
    """The whole page of a machine."""

    machine: str
    heard: str | None
    """When anything was last heard, this computer's UTC."""
    gateway_time: str | None
    """The gateway's own time of its latest message."""
    simulated: bool
    alive: bool
    commands: bool
    """Whether its configuration allows anybody to give commands."""
    paused: bool
    unarmed: bool
    """Whether its configuration leaves something off; `waits` begins with what."""
    notices: tuple[Sentence, ...]
    """Who has disarmed the gateway or paused the compensation."""
    verdict: ShownVerdict
    planned: tuple[str, ...]
    """Names of the planned loads of which the verdict may say something."""
    branches: list[ShownBranch]
    """The next two hours, as they are and under each planned load."""
    axes: tuple[ShownAxis, ...]
    tolerance_um: float | None
    errors: dict[str, float | None]
    """The nine thermal errors now, µm and µm/m; empty: no estimate is current."""
    reach: dict[str, list[float]]
    """By thermal error, the deviation in X, Y and Z at the chosen point, µm, per unit of it."""
    kinematics: str
    """Chain of axes that is corrected; empty: the gateway does not tell."""
    sphere_mm: tuple[float, float] | None
    """Radius and height of the probing sphere; None: the gateway does not tell."""
    tool_notes: tuple[Sentence, ...]
    waits: tuple[SaidRow, ...]
    channels: tuple[parts.ShownChannel, ...]
    inputs: dict[str, float | None]
    """Those of the last grid step that are no channels, such as loads; null: without a good value."""
    driven: tuple[parts.DrivenError, ...]
    reasons: str | None
    """When the learner gave the reasons of `driven`."""
    doubts: tuple[Sentence, ...]
    watched: Sentence | None
    health: tuple[SaidRow, ...]


def view(seen: MachineSeen, viewpoint: Viewpoint, now_s: float, own: tuple[SaidRow, ...] = ()) -> MachineView:
    """The page at this monotonic time. own: rows on the page's own program."""
    return MachineView(
        machine=seen.machine,
        heard=_seconds(seen.heard),
        gateway_time=_seconds(seen.latest),
        simulated=seen.simulated,
        alive=seen.present,
        commands=seen.status is not None and seen.status.commands,
        paused=seen.status is not None and seen.status.paused is not None,
        unarmed=bool(seen.unarmed),
        notices=tuple(_orders(seen)),
        verdict=_verdict_on_page(verdict_of(seen, viewpoint, now_s), parts.failed(seen)),
        planned=_planned_loads(seen),
        branches=branches(seen, viewpoint, tool_now(seen, viewpoint.matrix, now_s).error),
        axes=_axes(seen, viewpoint, now_s),
        tolerance_um=viewpoint.tolerance_um,
        errors=_errors(seen, now_s),
        reach=dict(zip(THERMAL_ERRORS, np.round(viewpoint.matrix.T, 6).tolist(), strict=True)),
        kinematics="" if seen.status is None else seen.status.kinematics[:_MOST_CHAIN],
        sphere_mm=seen.sphere_mm,
        tool_notes=tuple(_tool_notes(seen)),
        waits=(*parts.waits(seen), *cost_of_waiting(seen, viewpoint.matrix, now_s)),
        channels=tuple(parts.channels(seen)),
        inputs=dict(parts.other_inputs(seen)),
        driven=tuple(parts.driven(seen)),
        reasons=None if seen.reasons is None else seen.reasons.time,
        doubts=tuple(parts.doubts(seen)),
        watched=parts.watched(seen),
        health=(*parts.health(seen), *own),
    )


def _planned_loads(seen: MachineSeen) -> tuple[str, ...]:
    """As the status names them, before there is a forecast; an older gateway names them only in its forecasts."""
    if seen.status is not None and seen.status.planned_loads:
        return seen.status.planned_loads
    return () if seen.forecast is None else tuple(seen.forecast.planned)


def _seconds(time: datetime | None) -> str | None:
    return None if time is None else time.isoformat(timespec="seconds")


def _verdict_on_page(verdict: Verdict, failed: Sentence | None) -> ShownVerdict:
    since = None if verdict.since is None else verdict.since.isoformat()
    return ShownVerdict(
        verdict.colour.value, verdict.word, verdict.because, since, verdict.before, verdict.helps, failed
    )


def _orders(seen: MachineSeen) -> Iterator[Sentence]:
    if not seen.present or seen.status is None:
        return
    for key, order in (("notice.disarmed", seen.status.disarmed), ("notice.paused", seen.status.paused)):
        if order is not None:
            yield Sentence(key, {"by": ToldName(order.by), "at": at(datetime.fromisoformat(order.since))})


def _axes(seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> tuple[ShownAxis, ...]:
    error = tool_now(seen, viewpoint.matrix, now_s).error
    if error is None:
        return ()
    in_force, (left, half, far) = applied(seen.compensation).offsets_um, told(error)
    return tuple(
        ShownAxis(
            axis,
            um(float(error.without[i]), sign=True),
            replace(um(left[i], sign=True), u=""),
            um(half[i]),
            um(far[i]),
            um(in_force[i], sign=True),
            colour.value,
        )
        for i, (axis, colour) in enumerate(zip("XYZ", standings(error, viewpoint.tolerance_um), strict=True))
    )


def _errors(seen: MachineSeen, now_s: float) -> dict[str, float | None]:
    if seen.decision is None or not seen.present or is_old(seen, now_s):
        return {}
    nine_now = zip(THERMAL_ERRORS, nine(seen.decision.corrected), strict=True)
    return {error: round(v, 2) if math.isfinite(v) else None for error, v in nine_now}


def _tool_notes(seen: MachineSeen) -> Iterable[Sentence]:
    step = seen.compensation
    if not seen.present:
        return
    if step is None or step.mode != "compensate":
        yield Sentence("tool.not_written")
    elif not applied(step).following:
        yield Sentence("tool.not_following", {"source": Word(f"source.{step.source}")})


@dataclass(frozen=True, slots=True)
class ShownCourse(ShownPast):
    """The chart of the last hours and the next ones."""

    left: list[list[float | None]]
    state: list[str]
    """The verdict's colour at each time; empty: there is no tolerance."""
    ahead_t: list[float]
    """The present and the next hours, as far as the forecasts have proved good so far."""
    ahead: list[list[float | None]]
    ahead_left: list[list[float | None]]
    ahead_half: list[list[float | None]]
    ahead_left_half: list[list[float | None]]
    """Of what is left: where the control follows, it is the estimate's uncertainty, and how far that has been off."""
    ahead_state: list[tuple[str, float, float]]
    """The verdict's colours, each from when to when."""
    said: Sentence | None
    """Why there is nothing to show."""


def shown_course(seen: MachineSeen, viewpoint: Viewpoint) -> ShownCourse:
    """The last hours at the chosen point."""
    matrix, tolerance_um = viewpoint.matrix, viewpoint.tolerance_um
    if not seen.estimates:
        none: list[list[float | None]] = [[]] * 3
        return ShownCourse(
            t=[],
            without=none,
            half=none,
            measured_t=[],
            measured=none,
            left=none,
            state=[],
            ahead_t=[],
            ahead=none,
            ahead_left=none,
            ahead_half=none,
            ahead_left_half=none,
            ahead_state=[],
            said=Sentence("chart.nothing"),
        )
    past = course(matrix, seen.estimates)
    dots = seen.measurements
    found = moved(matrix, np.stack([m.errors for m in dots])) if dots else np.empty((0, 3))
    coming = ahead(seen, matrix) if seen.present else None
    state = [] if tolerance_um is None else [colour.value for colour in colours(seen, past, tolerance_um)]
    later: list[datetime] = []
    values, left, halves, left_halves = (np.empty((0, 3)) for _ in range(4))
    later_state: list[tuple[str, float, float]] = []
    if coming is not None and (known := np.asarray(np.isfinite(coming.half).all(axis=1))).any():
        later = [seen.estimates[-1].at, *(time for time, told in zip(coming.at, known, strict=True) if told)]
        values = np.vstack([past.without[-1:], coming.without[known]])
        left = np.vstack([past.left[-1:], coming.left[known]])
        halves = np.vstack([past.half[-1:], coming.half[known]])
        left_halves = np.vstack([past.half[-1:], (coming.high - np.abs(coming.left))[known]])
        left[1:][~coming.known()[known]] = np.nan
        if (
            tolerance_um is not None
            and (seen_ahead := outlook(ToolError(past.without[-1], past.left[-1], past.half[-1]), coming)) is not None
        ):
            later_state = [
                (colour.value, begin.timestamp(), end.timestamp())
                for colour, begin, end in colours_ahead(seen_ahead, tolerance_um)
            ]
    return ShownCourse(
        t=[e.at.timestamp() for e in seen.estimates],
        without=columns(past.without),
        left=columns(past.left),
        half=columns(past.half),
        state=state,
        measured_t=[m.at.timestamp() for m in dots],
        measured=columns(found),
        ahead_t=[time.timestamp() for time in later],
        ahead=columns(values),
        ahead_left=columns(left),
        ahead_half=columns(halves),
        ahead_left_half=columns(left_halves),
        ahead_state=later_state,
        said=None,
    )


def _said(sentence: Sentence | None) -> tuple[Sentence, ...]:
    return () if sentence is None else (sentence,)


@dataclass(frozen=True, slots=True)
class ListedMachine:
    """One machine in the list."""

    machine: str
    colour: str
    word: str
    because: tuple[Sentence, ...]
    notices: tuple[Sentence, ...]
    heard: str | None
    """To the minute, so that a list of many machines does not change with every message."""


_WORST_FIRST = ("word.not_ready", "word.gone", "word.silent", "word.never", "word.old", "word.no_data", "word.unknown",
                "word.unsure", "word.probing", "word.no_tolerance", "word.ready")  # fmt: skip


def listed(
    machines: Mapping[str, MachineSeen], viewpoints: Mapping[str, Viewpoint], now_s: float
) -> list[ListedMachine]:
    """Every machine, the worst first. viewpoints: by machine."""
    found = [(seen, judged(seen, viewpoints[name], now_s)) for name, seen in sorted(machines.items())]
    found.sort(key=lambda each: _WORST_FIRST.index(each[1].word))
    return [
        ListedMachine(
            seen.machine,
            verdict.colour.value,
            verdict.word,
            verdict.because,
            (
                *_orders(seen),
                *_said(parts.failed(seen)),
                *(Sentence("notice.unarmed", {"text": in_each(text)}) for text in seen.unarmed),
            ),
            None if seen.heard is None else seen.heard.isoformat(timespec="minutes"),
        )
        for seen, verdict in found
    ]
