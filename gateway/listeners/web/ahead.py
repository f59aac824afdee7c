"""The next hours at the tool, from the published forecast, and what would help more: wait, measure or warm up.

A forecast claims no more than earlier ones have achieved: its ends are widened by how far such forecasts have been off,
and nothing is said of a time for which forecasts have not been compared with what came for long enough.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median

import msgspec
import numpy as np

from gateway.listeners.web.at_tool import ToolError, half_width, left_with, moved
from gateway.listeners.web.sentences import Atom, Sentence, ToldName, Word, at, lasting, tolerance, um
from gateway.model.codes import NoticeCode
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.messages import ForecastMessage, PublishedCourse
from gateway.telemetry.subscriber.instants import instant
from gateway.telemetry.subscriber.machine import MachineSeen, applied, believable
from talc.frame import BoolArray, FloatArray
from talc.indicators import TWO_SIDED_95
from talc.names import THERMAL_ERRORS

WAIT_S = 1800.0
"""What waiting is judged after."""
WARM_S = 7200.0
"""How long a warm-up takes."""
PROBE = Word("help.probe")


@dataclass(frozen=True, slots=True, eq=False)
class AheadError:
    """The error at the tool at S later times, (S, 3) each, µm; NaN: unknown."""

    at: tuple[datetime, ...]
    seconds: tuple[float, ...]
    without: FloatArray
    left: FloatArray
    half: FloatArray
    """Half of the 95 % interval of both, with what forecasts have been off."""
    far: FloatArray
    """The far end of what is left."""
    low: FloatArray
    """The least and the most that `far` will be, judged by the errors of earlier forecasts."""
    high: FloatArray
    measured_far: FloatArray
    """`far` if the machine is measured now."""
    waiting_half: FloatArray
    """Half of the 95 % interval if it is not measured, as the learner says it; likewise if it is measured now."""
    measured_half: FloatArray
    usual_far: FloatArray
    """`far` if the inputs have their usual values from now on."""

    def known(self) -> BoolArray:
        """(S,) whether earlier forecasts tell how far this one may be off."""
        return np.asarray(np.isfinite(self.high).all(axis=1), dtype=np.bool_)


def ahead(seen: MachineSeen, matrix: FloatArray) -> AheadError | None:
    """At one place; None: no forecast belongs to the latest estimate."""
    message = seen.forecast
    if message is None or seen.decision is None or not message.ahead_s:
        return None
    if seen.decision.k - message.k not in (0, 1):  # it follows its decision
        return None
    made = instant(message.time)
    return None if made is None or not _whole(message) else _ahead(seen, message, message.stays, made, matrix)


def planned_ahead(seen: MachineSeen, matrix: FloatArray) -> dict[str, AheadError | None]:
    """The same by planned load, if it runs from now on; None: it is not known yet what this load does."""
    message = seen.forecast
    if message is None or (made := instant(message.time)) is None or ahead(seen, matrix) is None:
        return {}
    return {
        name: _ahead(seen, message, courses, made, matrix) if _complete(courses, len(message.ahead_s)) else None
        for name, courses in message.planned.items()
    }


def ahead_along(
    seen: MachineSeen, page: ScenarioPage, courses: dict[str, PublishedCourse], matrix: FloatArray
) -> AheadError:
    """The same along courses of a scenario. A forecast for a time claims no more than those for the next longer time
    that have been checked. Raises ValueError without a forecast, or for columns of different lengths."""
    message, made = seen.forecast, instant(page.time)
    if message is None or made is None or not _whole(message):
        raise ValueError("there is no forecast for now")
    later = [next((i for i, s in enumerate(message.ahead_s) if s >= t), None) for t in page.ahead_s]

    def of(column: list[float | None]) -> list[float | None]:
        return [None if i is None else column[i] for i in later]

    missed = {error: PublishedCourse(of(each.value), of(each.sigma)) for error, each in message.missed.items()}
    measured = {error: each.sigma for error, each in courses.items()}
    asked = msgspec.structs.replace(
        message, ahead_s=page.ahead_s, stays=courses, usual=courses, measured=measured, missed=missed, planned={}
    )
    if not _whole(asked):
        raise ValueError("the scenario has columns of different lengths")
    return _ahead(seen, asked, courses, made, matrix)


def _ahead(
    seen: MachineSeen, message: ForecastMessage, courses: dict[str, PublishedCourse], made: datetime, matrix: FloatArray
) -> AheadError:
    now = applied(seen.compensation)
    value, sigma = _columns(courses)
    usual_value, usual_sigma = _columns(message.usual)
    measured = _stacked([message.measured[error] for error in THERMAL_ERRORS])
    missed, sigma_missed = _columns(message.missed)
    without, half, measured_half = moved(matrix, value), half_width(matrix, sigma), half_width(matrix, measured)
    left = left_with(without, now)
    far = np.abs(left) + half
    if now.following:
        spread = TWO_SIDED_95 * sigma_missed
        high = np.abs(left) + half_width(matrix, sigma + spread)
        low = np.abs(left) + half_width(matrix, np.maximum(sigma - spread, 0.0))
    else:
        off = half_width(matrix, missed)
        high = np.abs(left) + half_width(matrix, np.hypot(sigma, missed))
        low = np.maximum(np.abs(left) - off, 0.0) + half
    return AheadError(
        at=tuple(made + timedelta(seconds=s) for s in message.ahead_s),
        seconds=message.ahead_s,
        without=without,
        left=left,
        half=half_width(matrix, np.hypot(sigma, missed)),
        far=far,
        low=low,
        high=high,
        measured_far=np.abs(left) + measured_half,
        waiting_half=half,
        measured_half=measured_half,
        usual_far=np.abs(left_with(moved(matrix, usual_value), now)) + half_width(matrix, usual_sigma),
    )


def _whole(message: ForecastMessage) -> bool:
    """Whether each error has a number, or null, for each time; others may publish too."""
    size = len(message.ahead_s)
    courses = [
        column
        for table in (message.stays, message.usual, message.missed)
        for error in THERMAL_ERRORS
        if (course := table.get(error)) is not None
        for column in (course.value, course.sigma)
    ] + [message.measured.get(error, []) for error in THERMAL_ERRORS]
    within = all(0.0 < s < 7 * 86400.0 for s in message.ahead_s)
    return within and len(courses) == 7 * len(THERMAL_ERRORS) and all(len(column) == size for column in courses)


def _complete(courses: dict[str, PublishedCourse], size: int) -> bool:
    return all(
        error in courses and len(courses[error].value) == len(courses[error].sigma) == size for error in THERMAL_ERRORS
    )


def _columns(courses: dict[str, PublishedCourse]) -> tuple[FloatArray, FloatArray]:
    """(S, 9) values and sigmas."""
    own = [courses[error] for error in THERMAL_ERRORS]
    return _stacked([course.value for course in own]), _stacked([course.sigma for course in own])


def _stacked(columns: list[list[float | None]]) -> FloatArray:
    """(S, 9)"""
    return np.array([[believable(v) for v in column] for column in columns], dtype=np.float64).T


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """The worst axis from now on, straight between the forecast's times, as far as forecasts have been checked.

    Everything that says or shows when a machine will be ready, or until when it is, takes the time from here.
    """

    at: tuple[datetime, ...]
    """L times, the first of them now."""
    high: FloatArray
    """(L,) the most that is left, µm."""
    near: FloatArray
    """(L,) at least so much is left, µm."""
    low: FloatArray
    """(L,) the least that `high` can come to, µm."""
    axis: tuple[int, ...]
    """The worst one at each time."""

    def turn(self, tolerance_um: float) -> datetime | None:
        """When the whole interval comes within the tolerance, or no longer is; None: not as far as can be foreseen."""
        times = self.crossings(self.high, tolerance_um)
        return times[0] if times else None

    def crossings(self, values: FloatArray, limit_um: float) -> list[datetime]:
        """When (L,) values pass a limit."""
        inside = values <= limit_um
        return [
            self.at[i] + (self.at[i + 1] - self.at[i]) * float((limit_um - values[i]) / (values[i + 1] - values[i]))
            for i in np.flatnonzero(inside[1:] != inside[:-1])
        ]

    def axis_at(self, time: datetime) -> int:
        """The worst axis at the end of the step in which a time is."""
        return next((axis for each, axis in zip(self.at, self.axis, strict=True) if each >= time), self.axis[-1])


def outlook(now: ToolError, coming: AheadError) -> Outlook | None:
    """None: what is left now is not known, or no forecast has been checked yet."""
    checked = int(np.argmin(np.append(coming.known(), False)))
    if not checked or not np.isfinite(now.far).all():
        return None
    left, high, low = coming.left[:checked], coming.high[:checked], coming.low[:checked]
    # The widened interval reaches as far inwards as outwards.
    high, low = np.vstack([now.far, high]), np.vstack([now.far, low])
    near = np.vstack([now.near, 2.0 * np.abs(left) - high[1:]])
    made = coming.at[0] - timedelta(seconds=coming.seconds[0])
    worst = tuple(int(axis) for axis in np.argmax(high, axis=1))
    return Outlook((made, *coming.at[:checked]), high.max(axis=1), near.max(axis=1), low.max(axis=1), worst)


def when(now: ToolError | None, coming: AheadError | None, tolerance_um: float, *, ready: bool) -> Iterator[Sentence]:
    """When it will be ready, or until when it stays so."""
    if now is None or coming is None:
        yield Sentence("when.stays_unknown" if ready else "when.no_forecast")
        return
    seen = outlook(now, coming)
    if seen is None:
        yield Sentence("when.stays_unknown" if ready else "when.not_checked")
        return
    turn = seen.turn(tolerance_um)
    if ready:
        if turn is None:
            yield Sentence("when.stays", {"at": at(seen.at[-1])})
            return
        axis = Word("XYZ"[seen.axis_at(turn)])
        yield Sentence(
            "when.until",
            {"at": at(turn), "axis": axis, "tolerance": tolerance(tolerance_um)},
        )
        return
    if turn is not None:
        yield Sentence("when.ready", {"at": at(turn)})
        return
    outside = int(np.argmin(np.append(seen.low[1:] > tolerance_um, False)))
    if outside == len(coming.at):
        yield Sentence("when.not_within", {"at": at(coming.at[-1])})
        return
    if outside:
        yield Sentence("when.not_before", {"at": at(seen.at[outside])})
    else:
        yield Sentence("when.not_foreseeable")


def planned(
    now: ToolError | None, loads: dict[str, AheadError | None], tolerance_um: float, *, ready: bool
) -> Iterator[Sentence]:
    """When it will be ready under each planned load, or until when it stays so."""
    for load, coming in loads.items():
        values: dict[str, Atom] = {"load": ToldName(load)}
        if coming is None:
            yield Sentence("planned.unknown", values)
            continue
        seen = None if now is None else outlook(now, coming)
        if seen is None:
            yield Sentence("planned.not_checked", values)
        elif (turn := seen.turn(tolerance_um)) is not None:
            yield Sentence("planned.until" if ready else "planned.ready", values | {"at": at(turn)})
        elif ready:
            yield Sentence("planned.stays", values | {"at": at(seen.at[-1])})
        else:
            least, most = um(float(seen.low[-1])), um(float(seen.high[-1]))
            yield Sentence("planned.not_certain", values | {"at": at(seen.at[-1]), "low": least, "high": most})


@dataclass(frozen=True, slots=True)
class Option:
    """One thing that may be done."""

    what: Word
    far_um: float
    """The far end of what is then left, in the worst axis; NaN: unknown."""
    off_um: float
    """How far that may be wrong."""
    gain_um: float
    """By how much it reduces what is left now."""

    @property
    def counts(self) -> bool:
        """Whether its gain is larger than the possible error of that."""
        return self.gain_um > self.off_um  # NaN compares false


def cycle_took(seen: MachineSeen) -> float | None:
    """How long the last measurements took, s; None: unknown."""
    found = [m.lasted_s for m in seen.measurements if m.lasted_s is not None]
    return median(found) if found else None


def cycle_takes(seen: MachineSeen) -> Atom:
    """The same in brackets; empty: unknown."""
    took = cycle_took(seen)
    return ToldName("") if took is None else Sentence("lasts.brackets", {"lasts": lasting(took)})


_NO_PROBING = frozenset({NoticeCode.OFF_CHAIN, NoticeCode.OFF_NO_NC, NoticeCode.OFF_ONLY_READ, NoticeCode.OFF_PROBING})


def measures(seen: MachineSeen) -> bool:
    """Whether its configuration lets it measure."""
    return not any(text.code in _NO_PROBING for text in seen.unarmed)


def options(now: ToolError, coming: AheadError) -> tuple[Option, ...]:
    """Wait, measure, warm up."""
    seconds = np.array(coming.seconds)
    soon, later = (int(np.argmin(np.abs(seconds - s))) for s in (WAIT_S, WARM_S))
    off, here = np.max(coming.high - coming.far, axis=1), float(np.max(now.far))
    probed = now.far - (coming.far[soon] - coming.measured_far[soon])
    found = (
        (Word("help.wait"), float(np.max(coming.far[soon])), float(off[soon])),
        (PROBE, float(np.max(probed)), 0.0),
        (Word("help.warm"), float(np.max(coming.usual_far[later])), float(off[later])),
    )
    return tuple(Option(what, far, wrong, here - far) for what, far, wrong in found)


def advice(
    now: ToolError | None, coming: AheadError | None, tolerance_um: float, takes: "Atom | None", *, ready: bool
) -> Iterator[Sentence]:
    """What would help most, and what it leaves; then each option; and when warming up brings nothing more.

    takes: how long a measurement takes, as `cycle_takes` says it; None: it does not measure
    """
    if now is None or coming is None or not np.isfinite(now.far).all():
        return
    choices = [each for each in options(now, coming) if takes is not None or each.what != PROBE]
    if not ready:
        best = max(choices, key=lambda each: each.gain_um if each.counts else -math.inf)
        if best.counts:
            values = _values(best) | {"lasts": takes if takes is not None and best.what == PROBE else ToldName("")}
            key = "help.best_enough" if _enough(best, tolerance_um) else "help.best"
            yield Sentence(key, values | {"tolerance": tolerance(tolerance_um)})
        for each in choices:
            yield _said(each, tolerance_um)
        if not best.counts and all(math.isfinite(each.off_um) for each in choices):
            yield Sentence("help.nothing")
    if _settled(now, coming) and not choices[-1].counts:
        yield Sentence("help.stop")


def _said(option: Option, tolerance_um: float) -> Sentence:
    what = option.what
    if not (math.isfinite(option.far_um) and math.isfinite(option.off_um)):
        return Sentence("help.unforeseeable", {"what": what})
    if _enough(option, tolerance_um):
        return Sentence("help.enough", _values(option))
    return Sentence("help.option" if option.counts else "help.little", _values(option))


def _enough(option: Option, tolerance_um: float) -> bool:
    return option.far_um + option.off_um <= tolerance_um


def _values(option: Option) -> dict[str, Atom]:
    return {"what": option.what, "far": um(option.far_um), "gain": um(-option.gain_um, sign=True)}


def _settled(now: ToolError, coming: AheadError) -> bool:
    """Whether nothing gained within two hours is larger than the forecast's own error."""
    near = np.array(coming.seconds) <= WARM_S
    gain = np.max(now.far) - np.max(coming.far[near], axis=1)
    off = np.max(coming.high - coming.far, axis=1)[near]
    return bool(near.any() and (gain <= off).all())  # NaN compares false
