"""Parses the times of a recording, or says what is wrong with them and how they may be meant."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import product
from zoneinfo import ZoneInfo

import numpy as np

from gateway.config.problems import shown
from gateway.reporting.recordings.cells import Where, number_of
from gateway.reporting.recordings.problems import FileProblems
from talc.frame import FloatArray

TIME_UNITS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "days": 86400.0}
"""Seconds in a unit of a column of plain numbers."""

_EARLIEST_S = datetime(1900, 1, 1, tzinfo=UTC).timestamp()
_LATEST_S = datetime(2200, 1, 1, tzinfo=UTC).timestamp()
_SINCE_S = datetime(1980, 1, 1, tzinfo=UTC).timestamp()
_EXCEL = datetime(1899, 12, 30)  # noqa: DTZ001  # the zone is the clock's
_FAR_DAYS = 200_000
_MS_OF_A_DAY = 86_400_000
"""Excel counts to the millisecond; a day with eight decimals comes within half of one."""
_HOUR_S = 3600.0
_FRACTIONS = (("milliseconds", "ms"), ("microseconds", "us"), ("nanoseconds", "ns"))
_CALLED = {
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("s", "sec", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("min", "mins", "minute", "minutes", "minuten"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours", "std", "stunden"), "h"),
    **dict.fromkeys(("d", "day", "days", "tage"), "days"),
}
_UNIT_IN_NAME = re.compile(r"[\[(]\s*([a-z]+)\s*[\])]\s*$|[_\s/]([a-z]+)$", re.IGNORECASE)
_DAYS = ("%d.%m.%Y", "%d.%m.%y", "%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d", "%d-%b-%Y", "%d-%m-%Y", "%Y-%m-%d")
_CLOCKS = ("%H:%M", "%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M %p", "%I:%M:%S %p")
_GUESSED_FROM = 50
"""Cells."""
_MIDNIGHT = re.compile(r"(?<![\d:.,])24(:00(?::00(?:[.,]0+)?)?)(?![\d:])")
"""The end of a day, as ISO 8601 and many loggers write it."""
_REPEATED_SPACING_S = 1800.0
"""Only where rows are about this far apart does an equal time begin the repeated hour of a night."""


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """How times are written."""

    form: str = ""
    """Format of `strptime`, such as `%d.%m.%Y %H:%M`; `excel`: days since 1899-12-30; empty: ISO 8601, or a number."""
    zone: ZoneInfo | None = None
    """Zone of times that state none; None: UTC."""
    unit: str = ""
    """Unit of plain numbers, one of TIME_UNITS; empty: what the column's name says, otherwise seconds."""

    def named(self, column: str) -> "TimeFormat":
        """With the unit that a column's name says, if none is given."""
        return self if self.unit else replace(self, unit=unit_in(column))

    def second_of(self, cell: object) -> float | None:
        """UTC seconds of a cell; None: it is no such time. 24:00 is the midnight at the end of its day."""
        ends_day = _MIDNIGHT.search(cell) is not None if isinstance(cell, str) else False
        if ends_day:
            cell = _MIDNIGHT.sub(r"00\1", str(cell), count=1)
        if self.form == "excel" and (days := number_of(cell, default=None)) is not None:
            cell = _EXCEL + timedelta(milliseconds=round(days * _MS_OF_A_DAY)) if abs(days) < _FAR_DAYS else None
        elif self.form not in ("", "excel"):
            try:
                cell = datetime.strptime(str(cell), self.form)  # noqa: DTZ007  # the zone is this clock's
            except ValueError:
                return None
        elif isinstance(cell, str) and (ends_day or self.zone is not None) and number_of(cell, default=None) is None:
            cell = _iso(cell)
        if ends_day:
            if not isinstance(cell, datetime):
                return None
            cell += timedelta(days=1)
        if isinstance(cell, datetime) and cell.tzinfo is None:
            cell = cell.replace(tzinfo=self.zone or UTC)
        return second_of(cell, TIME_UNITS[self.unit or "s"])

    def later(self, second: float, before: float, spacing_s: float) -> float:
        """The same time of day an hour later, if that is its second time in the night in which summer time ends.

        spacing_s: between the rows before it.
        """
        if self.zone is None or second > before or (second == before and spacing_s < _REPEATED_SPACING_S):
            return second
        # Excel's 02:00 may be a fraction of a second before the hour that comes twice.
        for near in (second, float(round(second))):
            again = datetime.fromtimestamp(near, self.zone).replace(fold=1).timestamp() + second - near
            if again >= before:
                return again
        return second


_DEFAULT = TimeFormat()


class Times:
    """The time column, chunk by chunk: UTC seconds, ascending; equal ones may follow each other."""

    def __init__(self, problems: FileProblems, clock: TimeFormat = _DEFAULT) -> None:
        self._problems, self._clock = problems, clock
        self._before: tuple[float, object] | None = None
        self._spacing_s = 0.0
        """Spacing of the last rows whose times differ."""
        self.first_s: float | None = None
        """Time of the first row; None before it."""
        self.restarts: list[int] = []
        """Rows, from 0, at which another run begins with an earlier time."""
        self._rows = 0
        self._run: object = None
        self.dated = False
        """Whether any time so far is a date: not a plain number, or one that is a date since 1980 in seconds."""

    def take(self, cells: Sequence[object], where: Where, runs: Sequence[object] | None = None) -> FloatArray:
        """(rows,) s; NaN where a cell is not a time. runs: marks; where another one begins, time may start again."""
        found = np.full(len(cells), np.nan)
        for i, cell in enumerate(cells):
            second = self._clock.second_of(cell)
            if second is None:
                what = f"{shown(cell)} is not a time; expected {self._expected(cells, cell)}"
                self._problems.add(where(i), what, "no time")
            elif not _EARLIEST_S <= second <= _LATEST_S:
                what = f"{shown(cell)} is not within the years 1900 to 2200{self._fraction(second)}"
                self._problems.add(where(i), what, "far time")
            else:
                if runs is not None and self._before is not None and runs[i] != self._run and second < self._before[0]:
                    self.restarts.append(self._rows + i)
                    self._before = None
                if self._before is not None:
                    second = self._clock.later(second, self._before[0], self._spacing_s)
                    back_s = self._before[0] - second
                    if back_s > 0.0:
                        what = f"{shown(cell)} is earlier than the time before it, {shown(self._before[1])}"
                        self._problems.add(where(i), what + self._why(back_s), "back")
                    self._spacing_s = -back_s if back_s < 0.0 else self._spacing_s
                self._before = second, cell
                self.first_s = second if self.first_s is None else self.first_s
                self.dated = self.dated or second >= _SINCE_S or not self._is_count(cell)
                found[i] = second
            self._run = None if runs is None else runs[i]
        self._rows += len(cells)
        return found

    def repeated(self) -> str:
        """Why a time may occur twice where rows are a step each."""
        return self._summer(0.0)

    def _is_count(self, cell: object) -> bool:
        """Whether a cell is seconds from any beginning, as far as it says itself."""
        return not self._clock.form and number_of(cell, default=None) is not None

    def _expected(self, cells: Sequence[object], cell: object) -> str:
        told = [_MIDNIGHT.sub(r"00\1", str(each), count=1) for each in (cell, *cells[:_GUESSED_FROM])]
        fitting = [form for form in forms_of(told[1:]) if _fits(told[0].strip(), form)]
        if fitting:
            read = " or ".join(repr(form) for form in fitting)
            return f"{self._form()}; --time-format {read} reads this one"
        return self._form() + ("" if self._clock.form else "; --time-format names another")

    def _form(self) -> str:
        if self._clock.form == "excel":
            return "a number of days, as Excel counts them, or ISO 8601"
        return f"a time like {self._clock.form}" if self._clock.form else "ISO 8601 or a number"

    def _fraction(self, second: float) -> str:
        """What the numbers would be as present-day dates in a smaller unit."""
        number = second / TIME_UNITS[self._clock.unit or "s"]
        for name, unit in _FRACTIONS:
            if _SINCE_S <= number * TIME_UNITS[unit] <= _LATEST_S:
                return f"; are these {name}? --time-unit {unit} reads them so"
        return ""

    def _why(self, back_s: float) -> str:
        if self._clock.form not in ("", "excel") and not re.search("%[djcx]", self._clock.form):
            return "; these are times of day: add a column of dates as --time, and give these as --time-of-day"
        return self._summer(back_s) or (
            "; if another run begins here, name the column that differs between runs: --runs COLUMN; otherwise sort "
            "the rows by their time"
        )

    def _summer(self, back_s: float) -> str:
        """A remark if times go back by an hour less the rows' spacing, as local times do when summer time ends."""
        if self._clock.zone is not None or abs(back_s + self._spacing_s - _HOUR_S) > max(self._spacing_s, 60.0):
            return ""
        return (
            "; if a clock was set back when summer time ended, --time-zone, as in Europe/Zurich, tells the hours apart"
        )


def second_of(cell: object, unit_s: float = 1.0) -> float | None:
    """UTC seconds; a time without a zone is UTC. unit_s: unit of a plain number, s."""
    if isinstance(cell, str):
        cell = number_of(cell, default=_iso(cell))
    if isinstance(cell, datetime):
        try:
            return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()
        except (OverflowError, ValueError):  # the time zone moves it beyond the years that Python supports
            return None
    if isinstance(cell, int | float) and not isinstance(cell, bool) and math.isfinite(cell):
        return float(cell) * unit_s
    return None


def unit_in(column: str) -> str:
    """The unit that a column's name ends with (`t [h]`, `time_min`), one of TIME_UNITS; empty: none."""
    match = _UNIT_IN_NAME.search(column)
    return "" if match is None else _CALLED.get((match[1] or match[2]).lower(), "")


def forms_of(cells: Iterable[str]) -> list[str]:
    """The usual forms of `strptime` that read every cell; those that differ in day and month only are both named."""
    texts = [cell.strip() for cell in cells]
    forms = [f"{day} {clock}" for day, clock in product(_DAYS, _CLOCKS)]
    return [form for form in forms if texts and all(_fits(text, form) for text in texts)]


def _fits(text: str, form: str) -> bool:
    try:
        datetime.strptime(text, form)  # noqa: DTZ007  # only whether it can be read
    except ValueError:
        return False
    return True


def _iso(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None
