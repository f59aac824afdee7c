"""Raw readings as thin rows, and how long they stay: thinned to minute statistics after a set time of running.

A reading's id is made of the run's number, the read's number and the channel's id, so that rows are appended, one
handed in twice is kept once, and no index is needed. The view `sample` shows them in words.

No age depends on a wall clock, which may jump. A mark is set at each pruning: for how long the gateway has run in this
file, by its monotonic clock, and what the newest rows were. What is older than a mark of that age goes.
"""

import logging
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import Quality
from gateway.model.codes import NoticeCode
from gateway.model.reading_blocks import READING_ROW, pack
from gateway.model.sample import Sample
from gateway.model.text import Text
from gateway.storage.faults import DamagedError

log = logging.getLogger(__name__)

_CHANNEL_BITS = 11
_SEQUENCE_BITS = 32
MOST_CHANNELS = 2**_CHANNEL_BITS - 1
"""Names with their units that one database can number in its life."""
MOST_BOOTS = 2**20 - 1
RUN_SHIFT = _CHANNEL_BITS + _SEQUENCE_BITS
"""The number of the run, from this bit of a reading's id on."""
_BOOT = f"(id >> {RUN_SHIFT})"
_SEQUENCE = f"((id >> {_CHANNEL_BITS}) & {2**_SEQUENCE_BITS - 1})"
CHANNEL_OF = f"(id & {2**_CHANNEL_BITS - 1})"
QUALITIES = tuple(Quality)
"""By number; new ones go to the end."""
_WORDS = " ".join(f"WHEN {number} THEN '{quality.value}'" for number, quality in enumerate(QUALITIES))

TABLES = f"""
CREATE TABLE channel (id INTEGER PRIMARY KEY, name TEXT NOT NULL, unit TEXT NOT NULL);
CREATE TABLE reading (id INTEGER PRIMARY KEY, time REAL NOT NULL, value REAL, quality INTEGER NOT NULL, detail TEXT);
CREATE TABLE minute (id INTEGER PRIMARY KEY, channel INTEGER NOT NULL, time INTEGER NOT NULL, count INTEGER NOT NULL,
    mean REAL NOT NULL, low REAL NOT NULL, high REAL NOT NULL);
CREATE TABLE mark (id INTEGER PRIMARY KEY, ran_s REAL NOT NULL, reading INTEGER NOT NULL, step INTEGER NOT NULL,
    reasons INTEGER NOT NULL, minute INTEGER NOT NULL);
CREATE VIEW sample AS SELECT r.boot AS boot, r.sequence AS sequence, c.name AS channel, r.time AS time,
    r.value AS value, c.unit AS unit, CASE r.quality {_WORDS} END AS quality, coalesce(r.detail, '') AS detail
    FROM (SELECT *, {_BOOT} AS boot, {_SEQUENCE} AS sequence, {CHANNEL_OF} AS channel FROM reading) r
    JOIN channel c ON c.id = r.channel;
"""
READ_ROWS = (
    f"SELECT r.id, r.time, c.name, r.value, c.unit, r.quality, r.detail, r.id >> {RUN_SHIFT},"
    f" (r.id >> {_CHANNEL_BITS}) & {2**_SEQUENCE_BITS - 1} FROM reading r"
    f" JOIN channel c ON c.id = (r.id & {2**_CHANNEL_BITS - 1})"
)
"""Number, UTC timestamp, channel, value, unit, number of the quality, detail, numbers of the run and of the read."""
EARLIER = "sample_before"
"""Readings of an earlier schema, as they were; dropped when they are old enough."""

_SECONDS_PER_DAY = 86400.0
_LEAST_S = 60.0
"""Between two marks."""
_MOST_GATHERED = 1_000_000
"""Readings of which means are made at once; of an earlier program's file the rest follow ten minutes later."""
BLOCK_ROWS = 50_000
"""Most readings of a block."""
_DAMPED = 0.9
"""Share of the largest size that is left after making room."""


class Channels:
    """The numbers of channels in a database."""

    def __init__(self, known: Sequence[tuple[int, str, str]]) -> None:
        self._ids = {(name, unit): number for number, name, unit in known if number <= MOST_CHANNELS}
        self._is_full = False

    def rows(self) -> list[tuple[int, str, str]]:
        """Rows of `channel`."""
        return [(number, name, unit) for (name, unit), number in self._ids.items()]

    def new(self, readings: Sequence[Sample]) -> list[tuple[int, str, str]]:
        """Rows of `channel` to add before these readings; none once all numbers are taken."""
        added: list[tuple[int, str, str]] = []
        for r in readings:
            if (r.channel, r.unit) in self._ids:
                continue
            number = max(self._ids.values(), default=0) + 1
            if number > MOST_CHANNELS:
                self._tell_that_it_is_full(r.channel)
                continue
            self._ids[(r.channel, r.unit)] = number
            added.append((number, r.channel, r.unit))
        return added

    def _tell_that_it_is_full(self, channel: str) -> None:
        if not self._is_full:
            self._is_full = True
            log.error("%s", Text(NoticeCode.CHANNELS_FULL, n=MOST_CHANNELS, channel=channel))

    def readings(self, boot: int, readings: Sequence[Sample]) -> list[tuple[object, ...]]:
        """Rows of `reading`: of the channels that have a number."""
        return [
            (
                (boot << _SEQUENCE_BITS | r.sequence) << _CHANNEL_BITS | self._ids[(r.channel, r.unit)],
                r.source_time.timestamp(),
                None if r.value != r.value else r.value,
                QUALITIES.index(r.quality),
                r.detail or None,
            )
            for r in readings
            if (r.channel, r.unit) in self._ids
        ]


def last_boot(connection: sqlite3.Connection) -> object:
    """The highest number of a run that left a reading; 0: none did."""
    (last,) = connection.execute(
        f"SELECT coalesce((SELECT {_BOOT} FROM reading ORDER BY id DESC LIMIT 1), 0)"
    ).fetchone()
    return last


def counts(connection: sqlite3.Connection) -> list[tuple[str, str, int]]:
    """Channel, quality and number of readings."""
    found = connection.execute(
        f"SELECT c.name, CASE r.quality {_WORDS} END, sum(r.many) FROM (SELECT {CHANNEL_OF} AS channel, quality,"
        " count(*) AS many FROM reading GROUP BY 1, 2) r JOIN channel c ON c.id = r.channel GROUP BY 1, 2"
    )
    return found.fetchall()


@dataclass(frozen=True, slots=True, kw_only=True)
class Retention:
    """How long rows stay, in days of running, and how large the database may become."""

    samples_days: float = 7.0
    minutes_days: float = 400.0
    most_mb: float = 4000.0


class Pruning:
    """Deletes what is old enough; at each call the monotonic clock says how long the gateway has run since the last."""

    def __init__(self, retention: Retention, monotonic_s: float) -> None:
        self._keep, self._marked_s = retention, monotonic_s

    def mark(self, connection: sqlite3.Connection, monotonic_s: float) -> float:
        """Set a mark, if the latest one is not of this minute. Returns for how long the gateway has run."""
        latest = connection.execute("SELECT ran_s FROM mark ORDER BY id DESC LIMIT 1").fetchone()
        if latest is not None and not isinstance(latest[0], float):
            raise DamagedError("the time of a mark is not a number")
        passed_s = max(0.0, monotonic_s - self._marked_s)
        ran_s = passed_s + (0.0 if latest is None else latest[0])
        if latest is None or passed_s >= _LEAST_S:
            self._marked_s = monotonic_s
            connection.execute(
                "INSERT INTO mark SELECT NULL, ?, coalesce((SELECT max(id) FROM reading), 0),"
                " coalesce((SELECT max(id) FROM compensation), 0), coalesce((SELECT max(k) FROM reasons), -1),"
                " coalesce((SELECT max(id) FROM minute), 0)",
                (ran_s,),
            )
        return ran_s

    def prune(self, connection: sqlite3.Connection, monotonic_s: float) -> None:
        """Set a mark, thin raw readings that are old enough, and delete other rows that are."""
        ran_s = self.mark(connection, monotonic_s)
        old = self._before(connection, ran_s - self._keep.samples_days * _SECONDS_PER_DAY)
        if old is not None:
            _thin(connection, old)
            connection.execute(f"DROP TABLE IF EXISTS {EARLIER}")
        ancient = self._before(connection, ran_s - self._keep.minutes_days * _SECONDS_PER_DAY)
        if ancient is not None:
            (minute,) = connection.execute("SELECT minute FROM mark WHERE id = ?", (ancient,)).fetchone()
            _delete_old(connection, "minutes", "minute", minute)
            connection.execute("DELETE FROM mark WHERE id < ?", (ancient,))
        self._make_room(connection)
        _gather(connection)

    def _before(self, connection: sqlite3.Connection, before_s: float) -> int | None:
        found = connection.execute("SELECT max(id) FROM mark WHERE ran_s <= ?", (before_s,)).fetchone()[0]
        return None if found is None else int(found)

    def _make_room(self, connection: sqlite3.Connection) -> None:
        """Thin readings before their time, the oldest first, then delete minutes; nothing else is ever deleted."""
        if _used_mb(connection) <= self._keep.most_mb:
            return
        connection.execute(f"DROP TABLE IF EXISTS {EARLIER}")
        marks = connection.execute(
            "SELECT id FROM mark WHERE reading >= (SELECT min(id) FROM reading) ORDER BY id"
        ).fetchall()
        for (mark,) in marks:
            if _used_mb(connection) <= _DAMPED * self._keep.most_mb:
                return
            _thin(connection, mark)
        if _used_mb(connection) > self._keep.most_mb:
            (tenth,) = connection.execute("SELECT min(id) + (max(id) - min(id)) / 10 - 1 FROM minute").fetchone()
            _delete_old(connection, "minutes", "minute", tenth)


def _thin(connection: sqlite3.Connection, mark: int) -> None:
    """Raw readings up to a mark become minute statistics; steps of the compensation and reasons up to it go.

    The newest row of each stays, so that no number is given twice.
    """
    reading, step, reasons = connection.execute(
        "SELECT reading, step, reasons FROM mark WHERE id = ?", (mark,)
    ).fetchone()
    connection.execute(
        f"INSERT INTO minute SELECT NULL, {CHANNEL_OF}, CAST(time / 60 AS INTEGER) * 60, count(*), avg(value),"
        " min(value), max(value) FROM reading WHERE id <= ? AND id < (SELECT max(id) FROM reading)"
        " AND value IS NOT NULL AND quality = ? GROUP BY 2, 3 ORDER BY 3, 2",
        (reading, QUALITIES.index(Quality.GOOD)),
    )
    _delete_old(connection, "readings", "reading", reading)
    _forget(connection, reading)
    _delete_old(connection, "compensation", "compensation", step)
    _delete_old(connection, "reasons", "reasons", reasons, "k")


def _delete_old(connection: sqlite3.Connection, name: str, table: str, upto: int | None, number: str = "id") -> None:
    """Delete rows up to a number, but for the newest, and note up to which. None: nothing.

    name: of the table outside the database
    number: its column
    """
    old = f"FROM {table} WHERE {number} <= ? AND {number} < (SELECT max({number}) FROM {table})"
    (last,) = connection.execute(f"SELECT max({number}) {old}", (upto,)).fetchone()
    if last is not None:
        connection.execute(f"DELETE {old}", (upto,))
        connection.execute("INSERT OR REPLACE INTO thinned VALUES (?, ?)", (name, last))


def _gather(connection: sqlite3.Connection) -> None:
    """Add minute means of the readings since the last time, so that a day is answered without looking at each of them.

    They are deleted together with the readings; a minute may be in two rows.
    """
    (above,) = connection.execute("SELECT coalesce(max(upto), 0) FROM gathered").fetchone()
    among = f"SELECT max(id) FROM (SELECT id FROM reading WHERE id > ? ORDER BY id LIMIT {_MOST_GATHERED})"
    (upto,) = connection.execute(among, (above,)).fetchone()
    if upto is not None:
        connection.execute(
            f"INSERT INTO recent_minute SELECT NULL, {CHANNEL_OF}, CAST(time / 60 AS INTEGER) * 60, count(*),"
            " avg(value) FROM reading WHERE id > ? AND id <= ? AND value IS NOT NULL AND quality = ? GROUP BY 2, 3"
            " ORDER BY 3, 2",
            (above, upto, QUALITIES.index(Quality.GOOD)),
        )
        connection.execute(
            "INSERT INTO gathered SELECT NULL, ?, ?, coalesce(max(id), 0) FROM recent_minute", (above, upto)
        )
        _pack(connection, above, upto)


def _pack(connection: sqlite3.Connection, above: int, upto: int) -> None:
    """Add blocks of the readings after one up to another, so that a long history is answered without looking at each of
    them. They are deleted together with the readings."""
    number = "CASE WHEN typeof(value) IN ('real', 'integer') THEN value ELSE 9e999 END"  # a bit may have flipped
    query = (
        f"SELECT id, {CHANNEL_OF}, time, {number}, quality FROM reading WHERE id > ? AND id <= ?"
        f" AND typeof(time) = 'real' AND typeof(quality) = 'integer' ORDER BY id LIMIT {BLOCK_ROWS}"
    )
    while len(rows := np.fromiter(connection.execute(query, (above, upto)), READING_ROW)):
        last = int(rows["id"][-1])
        connection.execute(
            "INSERT INTO reading_block VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?)", (above, last, *pack(rows))
        )
        above = last


def _forget(connection: sqlite3.Connection, reading: int | None) -> None:
    """Delete the means of readings of which some up to this one are gone."""
    gone = "FROM gathered WHERE above < ?"
    connection.execute(f"DELETE FROM recent_minute WHERE id <= (SELECT max(last) {gone})", (reading,))
    connection.execute(f"DELETE {gone}", (reading,))
    connection.execute("DELETE FROM reading_block WHERE above < ?", (reading,))


def upto_thinned(connection: sqlite3.Connection, name: str) -> int | None:
    """The highest number of a row that was deleted because it was old; None: none was."""
    found = connection.execute("SELECT upto FROM thinned WHERE name = ?", (name,)).fetchone()
    return None if found is None else int(found[0])


def _used_mb(connection: sqlite3.Connection) -> float:
    (pages,), (free,), (size,) = (
        connection.execute(f"PRAGMA {name}").fetchone() for name in ("page_count", "freelist_count", "page_size")
    )
    return float((pages - free) * size / 1e6)
