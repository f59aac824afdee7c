"""Stored readings of a span of time, page by page, while a gateway writes: bounded work, no lock that delays it.

Rows have no index by time. Within a run their ids ascend with the time at which they were read, so the first and the
last row of a span are found by bisection of the ids. A span's edge is taken a little wider, as devices on several buses
are read at once, and then cut exactly. Where the clock was set back within a run, rows from before may be missed.
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from gateway.model.reading_blocks import READING_ROW, ReadingRows
from gateway.storage.faults import StoreError
from gateway.storage.readings import CHANNEL_OF, QUALITIES, RUN_SHIFT
from gateway.storage.schema import READABLE, SCHEMA_VERSION, UNREADABLE, unusable

MOST_SCANNED = 500_000
"""Rows that are looked at for one page; when few of them are of the wanted channels, the page is short."""
WIDER_S = 120.0
_LAST_ID = 2**63 - 1
_RUN_SPACE = 1 << RUN_SHIFT
_QUALITIES = np.array([quality.value for quality in QUALITIES], np.object_)


@dataclass(frozen=True, slots=True)
class ReadingsPage:
    """Readings in the order in which they were stored, as columns of one length."""

    period_s: float
    """0: single readings; 60: means of the good readings of a minute, as older ones are kept."""
    names: tuple[str, ...]
    """Channels; `channel` counts from 0 in this list."""
    units: tuple[str, ...]
    time: list[float]
    """UTC, seconds since 1970; of a minute its beginning."""
    channel: list[int]
    value: list[float | None]
    quality: list[str]
    next: str | None
    """Where the next page begins; None: this is the last one."""


def readings_page(
    path: Path,
    begin: datetime,
    end: datetime,
    channels: Sequence[str] | None,
    limit: int,
    after: str | None = None,
) -> ReadingsPage:
    """The next page of what was read from `begin` on and before `end`: first the minutes, then single readings.

    channels: only these; None: all
    limit: rows of a page, at least 1
    after: `next` of the previous page

    Raises ValueError naming a channel that was never read or a wrong `after`, StoreError if the database cannot be
    read.
    """
    minutes, last = place_of(after)
    with reading_connection(path) as connection:
        known = connection.execute("SELECT id, name, unit FROM channel ORDER BY id").fetchall()
        wanted = PageSpan(begin.timestamp(), end.timestamp(), channel_ids(known, channels))
        names, units = tuple(str(name) for _, name, _ in known), tuple(str(unit) for *_, unit in known)
        at = {number: place for place, (number, *_) in enumerate(known)}
        if minutes:
            rows, following = minutes_after(connection, wanted, limit, last)
            if len(rows) or following:
                return _page(60.0, names, units, at, rows, f"m{following}" if following else "r0")
        rows, following = readings_after(connection, wanted, limit, 0 if minutes else last)
        return _page(0.0, names, units, at, rows, f"r{following}" if following else None)


@contextmanager
def reading_connection(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection that only reads. Raises StoreError if the database cannot be read, also within the block."""
    if not path.is_file():
        raise StoreError(f"{path}: no such file")
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)) as connection:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version not in READABLE:
                raise StoreError(f"{path}: schema version {version}, expected {SCHEMA_VERSION}")
            yield connection
    except UNREADABLE as error:
        raise unusable(path, error) from error


@dataclass(frozen=True, slots=True)
class PageSpan:
    """The times and channels whose rows are wanted."""

    begin_s: float
    end_s: float
    channels: tuple[int, ...] | None
    """Their ids; None: all."""

    @property
    def chosen(self) -> str:
        """SQL that chooses them; the ids are our own integers."""
        return "" if self.channels is None else f" AND channel IN ({', '.join(map(str, self.channels))})"


def place_of(after: str | None) -> tuple[bool, int]:
    """Whether minutes come next, and after which id."""
    if after is None:
        return True, 0
    if after[:1] in ("m", "r") and after[1:].isdecimal() and len(after) <= 20 and int(after[1:]) < _LAST_ID:
        return after[0] == "m", int(after[1:])
    raise ValueError(f"after = {after!r}: expected `next` of the previous page")


def channel_ids(known: Sequence[tuple[int, str, str]], channels: Sequence[str] | None) -> tuple[int, ...] | None:
    if channels is None:
        return None
    names = {name for _, name, _ in known}
    for channel in channels:
        if channel not in names:
            there = ", ".join(sorted(names)) or "none yet"
            raise ValueError(f"channels: {channel!r} was never stored; stored are: {there}")
    return tuple(number for number, name, _ in known if name in channels)


def _page(
    period_s: float,
    names: tuple[str, ...],
    units: tuple[str, ...],
    at: Mapping[int, int],
    rows: ReadingRows,
    following: str | None,
) -> ReadingsPage:
    place = np.zeros(max(at, default=0) + 1, np.int64)
    place[list(at)] = list(at.values())
    value: list[float | None] = rows["value"].tolist()
    for missing in np.flatnonzero(~np.isfinite(rows["value"])).tolist():
        value[missing] = None
    return ReadingsPage(
        period_s=period_s,
        names=names,
        units=units,
        time=rows["time"].tolist(),
        channel=place[rows["channel"]].tolist(),
        value=value,
        quality=_QUALITIES[rows["quality"]].tolist(),
        next=following,
    )


def minutes_after(
    connection: sqlite3.Connection, span: PageSpan, limit: int, last: int
) -> tuple[ReadingRows, int | None]:
    """Rows of minutes after an id, and after which id to go on; None: no more are in the span."""
    (highest,) = connection.execute("SELECT coalesce(max(id), 0) FROM minute").fetchone()
    columns = "id, channel, CAST(time AS REAL) AS time, mean AS value, 0 AS quality"
    return _between(connection, "minute", columns, span, limit, (1, highest + 1), last)


def readings_after(
    connection: sqlite3.Connection, span: PageSpan, limit: int, last: int, behind: int = _LAST_ID
) -> tuple[ReadingRows, int | None]:
    """Single readings after an id and before another, and after which id to go on; None: no more are in the span."""
    parts, many = [np.empty(0, READING_ROW)], 0
    columns = f"id, {CHANNEL_OF} AS channel, time, value, quality"
    for low, high in runs_from(connection, last):
        if low >= behind:
            break
        ids = low, min(high, behind)
        more, following = _between(connection, "reading", columns, span, limit - many, ids, last)
        parts.append(more)
        many += len(more)
        if following is not None:
            return np.concatenate(parts), following
    return np.concatenate(parts), None


def _between(
    connection: sqlite3.Connection,
    table: str,
    columns: str,
    span: PageSpan,
    limit: int,
    ids: tuple[int, int],
    last: int,
) -> tuple[ReadingRows, int | None]:
    """Rows of the span among these ids (the second excluded), whose times ascend; see readings_after."""
    low = first_id(connection, table, *ids, span.begin_s - WIDER_S)
    high = first_id(connection, table, low, ids[1], span.end_s + WIDER_S)
    low = max(low, last + 1)
    looked_at = f"SELECT {columns} FROM {table} WHERE id >= ? AND id < ? ORDER BY id LIMIT {MOST_SCANNED}"
    found = connection.execute(
        f"SELECT id, channel, time, coalesce(value, 9e999), quality FROM ({looked_at})"
        f" WHERE time >= ? AND time < ?{span.chosen} LIMIT ?",
        (low, high, span.begin_s, span.end_s, limit),
    )
    rows = np.fromiter(found, READING_ROW)
    if len(rows) == limit:
        return rows, int(rows["id"][-1])
    behind = f"SELECT id FROM {table} WHERE id >= ? AND id < ? ORDER BY id LIMIT 1 OFFSET {MOST_SCANNED}"
    next_id = connection.execute(behind, (low, high)).fetchone()
    return rows, None if next_id is None else next_id[0] - 1


def runs_from(connection: sqlite3.Connection, last: int = 0) -> Iterator[tuple[int, int]]:
    """First id of each run that left a reading, and the first id behind it, from the run of `last` on."""
    at = last // _RUN_SPACE * _RUN_SPACE
    while True:
        found = connection.execute("SELECT id FROM reading WHERE id >= ? ORDER BY id LIMIT 1", (at,)).fetchone()
        if found is None:
            return
        at = min((found[0] // _RUN_SPACE + 1) * _RUN_SPACE, _LAST_ID)
        yield found[0], at


def first_id(connection: sqlite3.Connection, table: str, low: int, high: int, time: float | str) -> int:
    """The smallest id in low..high from which on the times are not before `time`; `high`, excluded: there is none.

    time: as the table has it: seconds, or text in UTC, which sorts as times do
    """
    at = f"SELECT id, time FROM {table} WHERE id >= ? AND id < ? ORDER BY id LIMIT 1"
    while low < high:
        middle = (low + high) // 2
        found = connection.execute(at, (middle, high)).fetchone()
        if found is None or found[1] >= time:
            high = middle
        else:
            low = found[0] + 1
    return low
