"""Means of stored readings over intervals of a span of time, page by page, while a gateway writes.

Of whole minutes the store has made means already (`recent_minute` beside readings, `minute` where they are thinned);
only readings that are not in them, and those of other intervals, are looked at one by one.
"""

import math
import sqlite3
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

from drivers.base import Quality
from gateway.storage.pages import (
    MOST_SCANNED,
    WIDER_S,
    ReadingsPage,
    channel_ids,
    first_id,
    reading_connection,
    runs_from,
)
from gateway.storage.readings import CHANNEL_OF, QUALITIES

_GOOD: Final = QUALITIES.index(Quality.GOOD)
_PLACES: Final = 2048
"""More than the highest id of a channel."""
_MINUTE_S: Final = 60
_IdRange = tuple[str, int, int]
"""Table, first id, and the first id behind them."""


def means_page(
    path: Path,
    begin: datetime,
    end: datetime,
    channels: Sequence[str] | None,
    limit: int,
    every_s: int,
    after: str | None = None,
) -> ReadingsPage:
    """The next page of the means of good readings in intervals of `every_s` seconds, counted from `begin`.

    `time` is where an interval begins; one in which a channel had no good reading is left out. Means of older readings
    are of minutes: such a minute counts where it begins. Where `every_s` is whole minutes, all do.

    limit: rows of a page; of a single interval it may have more, one for each channel

    Raises as `readings_page`.
    """
    at = _interval(after)
    with reading_connection(path) as connection:
        connection.execute("BEGIN")  # readings in means and others: as of one moment
        known = connection.execute("SELECT id, name, unit FROM channel ORDER BY id").fetchall()
        wanted = channel_ids(known, channels)
        means = _MeanFinder(connection, begin.timestamp(), end.timestamp(), every_s, wanted)
        at = means.first(at)
        most = max(1, limit // max(1, len(known if wanted is None else wanted)))
        upto = min(means.total, at + most, means.looked_at(at))
        found = sorted(means.between(at, upto).items())
        following = means.first(upto)
    place = {number: n for n, (number, *_) in enumerate(known)}
    return ReadingsPage(
        period_s=float(every_s),
        names=tuple(str(name) for _, name, _ in known),
        units=tuple(str(unit) for *_, unit in known),
        time=[begin.timestamp() + key // _PLACES * every_s for key, _ in found],
        channel=[place[key % _PLACES] for key, _ in found],
        value=[mean for _, mean in found],
        quality=[Quality.GOOD.value] * len(found),
        next=f"e{following}" if following < means.total else None,
    )


def _interval(after: str | None) -> int:
    """The first interval of the page."""
    if after is None:
        return 0
    if after[:1] == "e" and after[1:].isascii() and after[1:].isdecimal() and len(after) <= 20:
        return int(after[1:])
    raise ValueError(f"after = {after!r}: expected `next` of the previous page")


def _has_means(connection: sqlite3.Connection) -> bool:
    """An earlier program's database has none beside readings."""
    found = connection.execute("SELECT count(*) FROM sqlite_master WHERE name IN ('gathered', 'recent_minute')")
    return bool(found.fetchone()[0] == 2)


class _MeanFinder:
    """Finds the means of intervals, which are counted from 0.

    channels: ids; None: all
    """

    def __init__(
        self,
        connection: sqlite3.Connection,
        begin_s: float,
        end_s: float,
        every_s: int,
        channels: tuple[int, ...] | None,
    ) -> None:
        self._connection, self._begin_s, self._end_s, self._every_s = connection, begin_s, end_s, every_s
        whole = every_s % _MINUTE_S == 0 and _has_means(connection)
        self._time = "time" if not whole or begin_s % _MINUTE_S == 0 else f"CAST(time / {_MINUTE_S} AS INTEGER) * 60"
        self._chosen = "" if channels is None else f" AND channel IN ({', '.join(map(str, channels))})"
        self._minutes = [self._all("minute"), self._all("recent_minute")] if whole else [self._all("minute")]
        self._readings = self._single(in_means=whole)
        self.total = math.ceil((end_s - begin_s) / every_s)
        """Number of intervals."""

    def first(self, at: int) -> int:
        """The first interval from this one on in which there may be something; `total`: there is none."""
        found = self.total
        for table, low, behind in (*self._minutes, *self._readings):
            number = first_id(self._connection, table, low, behind, self._start(at) - WIDER_S)
            query = f"SELECT time FROM {table} WHERE id >= ? AND id < ? ORDER BY id LIMIT 1"
            row = self._connection.execute(query, (number, behind)).fetchone()
            if row is not None:
                found = min(found, max(at, self._interval(row[0])))
        return found

    def looked_at(self, at: int) -> int:
        """Before which interval to end, so that not too many readings are looked at one by one; at least one."""
        left, end = MOST_SCANNED, self.total
        for table, low, behind in self._readings:
            number = first_id(self._connection, table, low, behind, self._start(at) - WIDER_S)
            query = f"SELECT time FROM {table} WHERE id >= ? AND id < ? ORDER BY id LIMIT 1 OFFSET ?"
            row = self._connection.execute(query, (number, behind, left)).fetchone()
            if row is not None:
                return min(end, max(at + 1, self._interval(row[0])))
            count = f"SELECT count(*) FROM {table} WHERE id >= ? AND id < ?"
            left -= int(self._connection.execute(count, (number, behind)).fetchone()[0])
        return end

    def between(self, at: int, upto: int) -> dict[int, float]:
        """The means of these intervals, the second excluded, by interval and channel."""
        sums = dict[int, tuple[float, int]]()
        for table, low, behind in (*self._minutes, *self._readings):
            for key, total, count in self._sums(table, low, behind, at, upto):
                interval = min(max(key // _PLACES, at), upto - 1)  # it may be another by rounding
                place = interval * _PLACES + key % _PLACES
                before = sums.get(place, (0.0, 0))
                sums[place] = before[0] + total, before[1] + count
        return {place: total / count for place, (total, count) in sums.items()}

    def _sums(self, table: str, low: int, behind: int, at: int, upto: int) -> list[tuple[int, float, int]]:
        begin_s, end_s = self._start(at), min(self._start(upto), self._end_s)
        low = first_id(self._connection, table, low, behind, begin_s - WIDER_S)
        behind = first_id(self._connection, table, low, behind, end_s + WIDER_S)
        rows = (
            f"SELECT {CHANNEL_OF} AS channel, {self._time} AS time, value AS mean, 1 AS count, quality FROM reading"
            if table == "reading"
            else f"SELECT channel, time, mean, count, {_GOOD} AS quality FROM {table}"
        )
        found = self._connection.execute(
            f"SELECT CAST((time - ?) / ? AS INTEGER) * {_PLACES} + channel AS place, sum(mean * count), sum(count)"
            f" FROM ({rows} WHERE id >= ? AND id < ?) WHERE time >= ? AND time < ? AND quality = {_GOOD}"
            f" AND mean IS NOT NULL{self._chosen} GROUP BY place",
            (self._begin_s, self._every_s, low, behind, begin_s, end_s),
        )
        return found.fetchall()

    def _all(self, table: str) -> _IdRange:
        (highest,) = self._connection.execute(f"SELECT coalesce(max(id), 0) FROM {table}").fetchone()
        return table, 1, highest + 1

    def _single(self, *, in_means: bool) -> list[_IdRange]:
        """Readings by run; in_means: without those of which there are means."""
        query = "SELECT coalesce(min(above), 0), coalesce(max(upto), 0) FROM gathered"
        above, upto = self._connection.execute(query).fetchone() if in_means else (0, 0)
        found = list[_IdRange]()
        for low, behind in runs_from(self._connection):
            for first, last in ((low, min(behind, above + 1)), (max(low, upto + 1), behind)):
                if first < last:
                    found.append(("reading", first, last))
        return found

    def _start(self, interval: int) -> float:
        return self._begin_s + interval * self._every_s

    def _interval(self, time_s: float) -> int:
        return math.floor((time_s - self._begin_s) / self._every_s)
