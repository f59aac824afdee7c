"""What a browser shows of one machine or of all: made from what has been heard, at a time that is given."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from gateway.web import parts
from gateway.web.at_tool import course, moved
from gateway.web.seen import MachineSeen, applied
from gateway.web.sentences import Amount, Name, SaidRow, Sentence, Word, at, um
from gateway.web.verdict import Verdict, Viewpoint, judge, tool_now
from talc.frame import FloatArray


@dataclass(frozen=True, slots=True)
class ShownVerdict:
    """Part 1."""

    colour: str
    word: str
    because: tuple[Sentence, ...]
    since: str | None
    helps: tuple[Sentence, ...]


@dataclass(frozen=True, slots=True)
class ShownAxis:
    """Part 2, one axis at the chosen point; a number that is null is unknown."""

    axis: str
    without: Amount
    left: Amount
    half: Amount
    far: Amount
    in_force: Amount


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
    notices: tuple[Sentence, ...]
    """What everybody must know first: what is not armed."""
    verdict: ShownVerdict
    axes: tuple[ShownAxis, ...]
    tool_notes: tuple[Sentence, ...]
    waits: tuple[SaidRow, ...]
    channels: tuple[parts.ShownChannel, ...]
    driven: tuple[parts.DrivenError, ...]
    doubts: tuple[Sentence, ...]
    health: tuple[SaidRow, ...]


def view(seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> MachineView:
    """The page at this monotonic time."""
    return MachineView(
        machine=seen.machine,
        heard=_seconds(seen.heard),
        gateway_time=_seconds(seen.latest),
        simulated=seen.simulated,
        alive=seen.alive,
        notices=_notices(seen),
        verdict=_shown(judge(seen, viewpoint, now_s)),
        axes=_axes(seen, viewpoint.matrix, now_s),
        tool_notes=tuple(_tool_notes(seen)),
        waits=tuple(parts.waits(seen)),
        channels=tuple(parts.channels(seen)),
        driven=tuple(parts.driven(seen)),
        doubts=tuple(parts.doubts(seen)),
        health=tuple(parts.health(seen)),
    )


def _seconds(time: datetime | None) -> str | None:
    return None if time is None else time.isoformat(timespec="seconds")


def _shown(verdict: Verdict) -> ShownVerdict:
    since = None if verdict.since is None else verdict.since.isoformat()
    return ShownVerdict(verdict.colour.value, verdict.word, verdict.because, since, verdict.helps)


def _notices(seen: MachineSeen) -> tuple[Sentence, ...]:
    if not seen.alive or seen.status is None:
        return ()
    return tuple(Sentence("notice.unarmed", {"text": Name(text)}) for text in seen.status.unarmed)


def _axes(seen: MachineSeen, matrix: FloatArray, now_s: float) -> tuple[ShownAxis, ...]:
    error = tool_now(seen, matrix, now_s).error
    if error is None:
        return ()
    in_force = applied(seen.compensation).offsets_um
    return tuple(
        ShownAxis(
            axis,
            um(float(error.without[i]), sign=True),
            replace(um(float(error.left[i]), sign=True), u=""),
            um(float(error.half[i])),
            um(float(error.far[i])),
            um(in_force[i], sign=True),
        )
        for i, axis in enumerate("XYZ")
    )


def _tool_notes(seen: MachineSeen) -> Iterable[Sentence]:
    step = seen.compensation
    if step is None or step.mode != "compensate":
        yield Sentence("tool.not_written")
    elif not applied(step).following:
        yield Sentence("tool.not_following", {"source": Word(f"source.{step.source}")})


@dataclass(frozen=True, slots=True)
class ShownCourse:
    """The charts: columns by axis over the time; null: unknown."""

    t: list[float]
    """UTC seconds."""
    without: list[list[float | None]]
    left: list[list[float | None]]
    half: list[list[float | None]]
    measured_t: list[float]
    measured: list[list[float | None]]
    """What measurements found, without compensation."""
    said: Sentence | None
    """Why there is nothing to show."""


def shown_course(seen: MachineSeen, matrix: FloatArray) -> ShownCourse:
    """The last hours at the chosen point."""
    if not seen.estimates:
        return ShownCourse([], [[]] * 3, [[]] * 3, [[]] * 3, [], [[]] * 3, Sentence("chart.nothing"))
    past = course(matrix, seen.estimates)
    dots = seen.measurements
    found = moved(matrix, np.stack([m.errors for m in dots])) if dots else np.empty((0, 3))
    return ShownCourse(
        t=[e.at.timestamp() for e in seen.estimates],
        without=_columns(past.without),
        left=_columns(past.left),
        half=_columns(past.half),
        measured_t=[m.at.timestamp() for m in dots],
        measured=_columns(found),
        said=Sentence("chart.since", {"at": at(seen.estimates[0].at)}),
    )


def _columns(values: FloatArray) -> list[list[float | None]]:
    """(n, 3) as three lists, to a hundredth of a micrometre."""
    return [[round(v, 2) if np.isfinite(v) else None for v in column] for column in values.T.tolist()]


@dataclass(frozen=True, slots=True)
class ListedMachine:
    """One machine in the list."""

    machine: str
    colour: str
    word: str
    because: tuple[Sentence, ...]
    notices: tuple[Sentence, ...]
    heard: str | None


_WORST_FIRST = ("word.not_ready", "word.gone", "word.never", "word.old", "word.no_data", "word.unknown", "word.unsure",
                "word.probing", "word.no_tolerance", "word.ready")  # fmt: skip


def listed(
    machines: Mapping[str, MachineSeen], viewpoints: Mapping[str, Viewpoint], now_s: float
) -> list[ListedMachine]:
    """Every machine, the worst first. viewpoints: by machine."""
    judged = [(seen, judge(seen, viewpoints[name], now_s)) for name, seen in sorted(machines.items())]
    judged.sort(key=lambda each: _WORST_FIRST.index(each[1].word))
    return [
        ListedMachine(
            seen.machine,
            verdict.colour.value,
            verdict.word,
            verdict.because,
            _notices(seen),
            _seconds(seen.heard),
        )
        for seen, verdict in judged
    ]
