"""Parses the cells of a recording: times and numbers, or what is wrong with them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import TypeVar
from zoneinfo import ZoneInfo

import numpy as np

from gateway.config import shown
from gateway.recordings.problems import FileProblems
from talc.frame import FloatArray

Where = Callable[[int], str]
"""Place of a cell, for a person, by its position in the chunk."""

_Else = TypeVar("_Else")

_EARLIEST_S = datetime(1900, 1, 1, tzinfo=UTC).timestamp()
_LATEST_S = datetime(2200, 1, 1, tzinfo=UTC).timestamp()
_SINCE_S = datetime(1980, 1, 1, tzinfo=UTC).timestamp()
_EXCEL = datetime(1899, 12, 30)  # noqa: DTZ001  # the zone is the clock's
_FAR_DAYS = 200_000
_HOUR_S = 3600.0
_FRACTIONS = (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """How times are written."""

    form: str = ""
    """Of `strptime`, such as `%d.%m.%Y %H:%M`; `excel`: days since 1899-12-30; empty: ISO 8601, or seconds."""
    zone: ZoneInfo | None = None
    """Of times without one; None: UTC."""

    def second_of(self, cell: object) -> float | None:
        """UTC seconds of a cell; None: it is no such time."""
        if self.form == "excel" and (days := _number(cell, default=None)) is not None:
            cell = _EXCEL + timedelta(days=days) if abs(days) < _FAR_DAYS else None
        elif self.form not in ("", "excel"):
            try:
                cell = datetime.strptime(str(cell), self.form)  # noqa: DTZ007  # the zone is this clock's
            except ValueError:
                return None
        elif self.zone is not None and isinstance(cell, str) and _number(cell, default=None) is None:
            cell = _iso(cell)
        if isinstance(cell, datetime) and cell.tzinfo is None:
            cell = cell.replace(tzinfo=self.zone or UTC)
        return second_of(cell)

    def later(self, second: float, before: float) -> float:
        """The same time of day an hour later, if that is its second time in the night in which summer time ends."""
        if self.zone is None or second > before:
            return second
        # Excel's 02:00 may be a fraction of a second before the hour that comes twice.
        for near in (second, float(round(second))):
            again = datetime.fromtimestamp(near, self.zone).replace(fold=1).timestamp() + second - near
            if again > before:
                return again
        return second


_DEFAULT = TimeFormat()


class Times:
    """The time column, chunk by chunk: UTC seconds, ascending."""

    def __init__(self, problems: FileProblems, clock: TimeFormat = _DEFAULT) -> None:
        self._problems, self._clock = problems, clock
        self._before: tuple[float, object] | None = None
        self.first_s: float | None = None
        """Of the first row; None before it."""
        self.dated = False
        """Whether any time so far is a date: not a plain number, or one that is a date since 1980 in seconds."""

    def take(self, cells: Sequence[object], where: Where) -> FloatArray:
        """(rows,) s; NaN where a cell is not a time."""
        found = np.full(len(cells), np.nan)
        for i, cell in enumerate(cells):
            second = self._clock.second_of(cell)
            if second is None:
                self._problems.add(where(i), f"{shown(cell)} is not a time; expected {self._expected()}")
            elif not _EARLIEST_S <= second <= _LATEST_S:
                self._problems.add(where(i), f"{shown(cell)} is not within the years 1900 to 2200{_fraction(second)}")
            else:
                if self._before is not None:
                    second = self._clock.later(second, self._before[0])
                    if second <= self._before[0]:
                        what = f"{shown(cell)} is not later than the time before it, {shown(self._before[1])}"
                        self._problems.add(where(i), what + self._repeated_hour(self._before[0] - second))
                self._before = second, cell
                self.first_s = second if self.first_s is None else self.first_s
                self.dated = self.dated or second >= _SINCE_S or not self._is_count(cell)
                found[i] = second
        return found

    def _is_count(self, cell: object) -> bool:
        """Whether a cell is seconds from any beginning, as far as it says itself."""
        return not self._clock.form and _number(cell, default=None) is not None

    def _expected(self) -> str:
        if self._clock.form == "excel":
            return "a number of days, as Excel counts them, or ISO 8601"
        return (
            f"a time like {self._clock.form}"
            if self._clock.form
            else "ISO 8601 or seconds; --time-format names another"
        )

    def _repeated_hour(self, back_s: float) -> str:
        """Why local times may go back by up to an hour."""
        if self._clock.zone is not None or not 0.0 < back_s <= _HOUR_S:
            return ""
        return (
            "; if a clock was set back when summer time ended, --time-zone, as in Europe/Zurich, tells the hours apart"
        )


def second_of(cell: object) -> float | None:
    """UTC seconds; a time without a zone is UTC."""
    if isinstance(cell, str):
        cell = _number(cell, default=_iso(cell))
    if isinstance(cell, datetime):
        try:
            return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
        except (OverflowError, ValueError):  # the time zone moves it beyond the years that Python supports
            return None
    if isinstance(cell, int | float) and not isinstance(cell, bool) and math.isfinite(cell):
        return float(cell)
    return None


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _fraction(second: float) -> str:
    """What the numbers would be as present-day dates in a smaller unit."""
    for unit, parts in _FRACTIONS:
        if _SINCE_S <= second / parts <= _LATEST_S:
            return f"; are these {unit}? Seconds are expected: divide them by {parts:.0f}"
    return ""


def numbers_of(cells: Sequence[object], largest: float, where: Where, problems: FileProblems) -> FloatArray:
    """(rows,) NaN where the cell is empty or says `nan`. largest: the largest magnitude allowed."""
    try:
        found = np.array([math.nan if cell in (None, "") else float(cell) for cell in cells])  # type: ignore[arg-type]
        plain = not any(isinstance(cell, str) and "_" in cell for cell in cells)
        if plain and not (np.abs(found) > largest).any():
            return found
    except (TypeError, ValueError, OverflowError):
        pass
    found = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        value = math.nan if cell in (None, "") else _number(cell, default=math.inf)
        if math.isinf(value):
            problems.add(where(i), f"{shown(cell)} is not a finite number; leave an unknown value empty")
        elif abs(value) > largest:
            what = f"{shown(cell)} is beyond {largest:g}, the largest allowed; leave an unknown value empty"
            problems.add(where(i), what)
        else:
            found[i] = value
    return found


def _number(cell: object, default: _Else) -> float | _Else:
    """The cell as a float; otherwise `default`. Python reads `2_0` as 20, but no table means that."""
    if isinstance(cell, str) and "_" in cell:
        return default
    if isinstance(cell, int | float | str | Decimal):
        try:
            return float(cell)
        except (ValueError, OverflowError):
            return default
    return default
