"""Times as people at the machine read them, and their shifts."""

from collections.abc import Iterator, Sequence
from datetime import date, datetime, time, timedelta, tzinfo
from itertools import pairwise

from drivers.text import shown
from gateway.model.codes import NoticeCode
from gateway.model.text import Language, Text

_DAY = timedelta(days=1)
_ENGLISH = Language()


def local_moment(utc_s: float, zone: tzinfo, said: Language = _ENGLISH) -> str:
    """Such as `Mon 2026-01-05 06:00 CET`: the zone's name tells apart the hour that daylight saving repeats."""
    at = datetime.fromtimestamp(utc_s, zone)
    return f"{weekday(at, said)} {at:%Y-%m-%d %H:%M %Z}"


def weekday(day: date, said: Language) -> str:
    """Such as `Mon`."""
    return said("report.weekdays").split()[day.weekday()]


def since(seconds: float) -> str:
    """Such as `30:05 h`, of a recording that has no dates."""
    minutes = round(seconds / 60.0)
    return f"{minutes // 60}:{minutes % 60:02d} h"


def hours(seconds: float, said: Language) -> str:
    """Such as `10 s`, `12 min` or `3.5 h`."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{said.number(seconds / 3600.0, '.1f')} h"


def shifts_between(
    begin_utc_s: float, end_utc_s: float, begins: Sequence[time], zone: tzinfo
) -> Iterator[tuple[float, float]]:
    """UTC seconds of the start and of the end of each shift that overlaps that time, oldest first.

    A shift over a night in which the clock changes is an hour shorter or longer. Nothing without `begins`.
    """
    first = datetime.fromtimestamp(begin_utc_s, zone).date() - _DAY
    days = (datetime.fromtimestamp(end_utc_s, zone).date() - first).days + 2
    edges = sorted(datetime.combine(first + i * _DAY, begin, zone).timestamp() for i in range(days) for begin in begins)
    for edge, after in pairwise(edges):
        if edge < end_utc_s and after > begin_utc_s:
            yield edge, after


def shift_starts(text: str) -> tuple[time, ...]:
    """The times of day at which shifts begin, in order. Raises ValueError."""
    try:
        parts = [part.strip().partition(":") for part in text.split(",") if part.strip()]
        return tuple(sorted({time(int(hour), int(minute)) for hour, _, minute in parts}))
    except ValueError:
        raise ValueError(Text(NoticeCode.SHIFTS_FORM, value=shown(text))) from None
