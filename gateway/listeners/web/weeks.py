"""Scatter of the touches of measurements, week by week, from the gateway's store."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from statistics import median

from gateway.listeners.web.sentences import Amount, Atom, um
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.subscriber.machine import believable

WEEKS = timedelta(weeks=12)
MOST_MEASUREMENTS = 2000
"""Most measurements of twelve weeks: one each hour. If there are more, an even choice of them."""


@dataclass(frozen=True, slots=True)
class ScatterWeek:
    """One week that has a measurement."""

    t: float
    """Its Monday, UTC seconds."""
    n: Amount
    median: Amount
    most: Amount


@dataclass(frozen=True, slots=True)
class ScatterWeeks:
    """What a browser is sent."""

    weeks: list[ScatterWeek] | None
    """None: unknown."""
    why: "Atom | None"
    """Why it is unknown."""


def scatter_by_week(page: CoursePage) -> list[ScatterWeek]:
    """The latest week first. Raises ValueError for columns of different lengths."""
    if len(page.residual_um) != len(page.measured_time):
        raise ValueError(f"{len(page.residual_um)} residuals of {len(page.measured_time)} measurements")
    weeks: dict[float, list[float]] = {}
    for time, residual in zip(page.measured_time, map(believable, page.residual_um), strict=True):
        if math.isfinite(residual):
            weeks.setdefault(monday_of(time), []).append(residual)
    return [
        ScatterWeek(monday, Amount(len(found), d=0), um(median(found)), um(max(found)))
        for monday, found in sorted(weeks.items(), reverse=True)
    ]


def monday_of(time_s: float) -> float:
    """When the week of a time began: Monday, both UTC seconds. Raises ValueError for a number that is not a time."""
    try:
        day = datetime.fromtimestamp(time_s, UTC).date()
    except (OverflowError, OSError) as error:
        raise ValueError(f"{time_s} is not a time") from error
    return datetime.combine(day - timedelta(days=day.weekday()), datetime.min.time(), UTC).timestamp()
