"""The charts of the time before this page's program was listening, from the gateway's store."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from drivers.base import SetupError
from drivers.number_types import WRITTEN_NUMBER
from gateway.listeners.web.at_tool import half_width, moved
from gateway.listeners.web.parts import mark_of
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.messages import PublishedCourse
from gateway.telemetry.report_queries import LARGEST_TOLERANCE_UM
from gateway.telemetry.subscriber.machine import believable
from talc.frame import FloatArray
from talc.names import THERMAL_ERRORS

MOST_POINTS = 500
"""Most points of one answer: more than a chart on a panel has columns."""
EARLIEST_S = 946684800.0
"""2000."""
LATEST_S = 7258118400.0
"""2200."""


@dataclass(frozen=True, slots=True)
class ShownPast:
    """Columns by axis over the time; null: unknown."""

    t: list[float]
    """UTC seconds."""
    without: list[list[float | None]]
    half: list[list[float | None]]
    measured_t: list[float]
    measured: list[list[float | None]]
    """What measurements found, without compensation."""
    measured_left: list[list[float | None]] = field(default_factory=lambda: [[], [], []], kw_only=True)
    """What measurements found beyond the correction; of a gateway that does not tell, nothing."""
    temperatures: dict[str, list[float | None]] = field(default_factory=dict, kw_only=True)
    """By channel, at each time, the other inputs as well; only if they were asked for."""
    errors: dict[str, list[float | None]] = field(default_factory=dict, kw_only=True)
    """The nine thermal errors at each time, µm and µm/m; only if they were asked for."""
    marks: list[tuple[float, str]] = field(default_factory=list, kw_only=True)
    """When notable events were, UTC seconds, and their marks."""


def shown_past(page: CoursePage, matrix: FloatArray, *, by_error: bool = False) -> ShownPast:
    """At one place. Raises ValueError for columns of different lengths."""
    errors, sigma = estimates_of(page.errors, len(page.time))
    measured, _ = estimates_of(page.measured, len(page.measured_time))
    return ShownPast(
        t=page.time,
        without=columns(moved(matrix, errors)),
        half=columns(half_width(matrix, sigma)),
        measured_t=page.measured_time,
        measured=columns(moved(matrix, measured)),
        measured_left=columns(moved(matrix, _left(page))),
        temperatures={
            name: _temperature(name, column, len(page.time))
            for name, column in (page.temperatures | page.inputs).items()
        },
        errors=dict(zip(THERMAL_ERRORS, columns(errors, 4), strict=True)) if by_error else {},
        marks=[(time, mark) for time, kind in page.marked if math.isfinite(time) and (mark := mark_of(kind))],
    )


def _left(page: CoursePage) -> FloatArray:
    """(m, 9); of a gateway that does not tell, unknown."""
    size = len(page.measured_time)
    unknown: list[float | None] = [None] * size
    found = {e: PublishedCourse(page.left.get(e, unknown), unknown) for e in THERMAL_ERRORS}
    return estimates_of(found, size)[0]


def _temperature(name: str, column: list[float | None], size: int) -> list[float | None]:
    if len(column) != size:
        raise ValueError(f"{name}: {len(column)} numbers for {size} times")
    return [round(v, 2) if math.isfinite(v := believable(each)) else None for each in column]


def span(begin: str, end: str) -> tuple[datetime, datetime]:
    """The times that two texts of UTC seconds give. Raises ValueError."""
    from_s, to_s = written(begin), written(end)
    if not EARLIEST_S <= from_s < to_s <= LATEST_S:
        raise ValueError(
            f"from={begin[:40]}, to={end[:40]}: expected seconds since 1970, the second later than the first"
        )
    return datetime.fromtimestamp(from_s, UTC), datetime.fromtimestamp(to_s, UTC)


def written(text: str) -> float:
    """The number of a text in an address; NaN: it is not a number. Python also reads 1_0 and other scripts' digits."""
    return float(text) if WRITTEN_NUMBER.fullmatch(text) else math.nan


def asked_number(query: Mapping[str, str], name: str, least: float, largest: float) -> float | None:
    """The number of this name in an address; None: it is not there. Raises SetupError."""
    text = query.get(name)
    if text is None or text == "":
        return None
    value = written(text)
    if not least <= value <= largest:
        raise SetupError(Text(NoticeCode.ASKED_BEYOND, name=name, value=text[:40], least=least, largest=largest))
    return value


def asked_tolerance_um(query: Mapping[str, str]) -> float | None:
    """Likewise."""
    return asked_number(query, "tolerance", 1e-3, LARGEST_TOLERANCE_UM)


def columns(values: FloatArray, digits: int = 2) -> list[list[float | None]]:
    """(n, m) as m lists, rounded."""
    return [[round(v, digits) if math.isfinite(v) else None for v in column] for column in values.T.tolist()]


def estimates_of(found: dict[str, PublishedCourse], size: int) -> tuple[FloatArray, FloatArray]:
    """(n, 9) values and sigmas; an error that is not there is unknown."""
    tables = np.full((2, size, len(THERMAL_ERRORS)), np.nan)
    for j, error in enumerate(THERMAL_ERRORS):
        if (course := found.get(error)) is not None:
            for table, column in zip(tables, (course.value, course.sigma), strict=True):
                if len(column) != size:
                    raise ValueError(f"{error}: {len(column)} numbers for {size} times")
                table[:, j] = [believable(v) for v in column]
    return tables[0], tables[1]
