"""Epochs: spans of a database in which a row's number means only one row, so that collectors can continue.

Each start of a gateway begins one, and so does each database that is begun with what could be read of a damaged one:
rows that were lost, or a backup that was restored, give their numbers to others. An epoch notes the highest number of
each table at its begin; its rows are those above, up to the begin of the next one.
"""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final
from uuid import uuid4

from gateway.storage.faults import DamagedError

NUMBERS: Final[Mapping[str, str]] = {
    "measurements": "SELECT max(id) FROM measurement",
    "steps": "SELECT max(k) FROM decision",
    "models": "SELECT max(id) FROM model",
    "events": "SELECT max(id) FROM event",
    "compensation": "SELECT max(id) FROM compensation",
    "minutes": "SELECT max(id) FROM minute",
    "readings": "SELECT max(id) FROM reading",
    "commands": "SELECT max(id) FROM command",
    "runs": "SELECT max(number) FROM boot",
    "reasons": "SELECT max(k) FROM reasons",
}
"""Table, as it is called outside the database, to the query for its highest number; what matters most comes first."""
BEFORE_ALL: Final = -1_000_000
"""Below every number: a reference that is stored again goes before the first row."""
_MOST = 1000
"""Epochs that are kept; a collector that was away for longer begins again."""


@dataclass(frozen=True, slots=True)
class Position:
    """Up to which row of a table someone has everything."""

    epoch: str
    number: int


@dataclass(frozen=True, slots=True)
class RowSpan:
    """What comes next: rows above one number up to another one, of one epoch."""

    epoch: str
    above: int
    upto: int | None
    """None: of the running epoch, which has no end yet."""


def begin_epoch(connection: sqlite3.Connection) -> None:
    """Begin another epoch, in the caller's transaction; the first one of a database has all of its rows."""
    (last,) = connection.execute("SELECT max(number) FROM epoch").fetchone()
    starts = {}
    if last is not None:
        highest = {table: connection.execute(query).fetchone()[0] for table, query in NUMBERS.items()}
        starts = {table: number for table, number in highest.items() if number is not None}
    connection.execute("INSERT INTO epoch VALUES (NULL, ?, ?)", (uuid4().hex, json.dumps(starts)))
    connection.execute("DELETE FROM epoch WHERE number <= ?", ((last or 0) + 1 - _MOST,))


def next_span(connection: sqlite3.Connection, table: str, position: Position | None) -> RowSpan | None:
    """What comes after a position; None: this database knows nothing of its epoch."""
    at = 0
    if position is not None:
        found = connection.execute("SELECT number FROM epoch WHERE name = ?", (position.epoch,)).fetchone()
        if found is None:
            return None
        (at,) = found
    epochs = connection.execute("SELECT name, starts FROM epoch WHERE number >= ? ORDER BY number", (at,)).fetchall()
    return _after(epochs, table, BEFORE_ALL if position is None else position.number)


def _after(epochs: Sequence[tuple[str, str]], table: str, number: int) -> RowSpan | None:
    for (name, _), (_, following) in pairwise(epochs):
        end = _start(following, table)
        if number < end:
            return RowSpan(name, number, end)
        number = end  # rows that this file does not have no longer belong to the epoch
    return RowSpan(epochs[-1][0], number, None) if epochs else None


def _start(starts: str, table: str) -> int:
    try:
        return int(json.loads(starts).get(table, BEFORE_ALL))
    except (ValueError, AttributeError, TypeError):
        raise DamagedError("the record of where an epoch begins is invalid") from None


def check_epoch(row: Sequence[object]) -> None:
    """Raises an error for an invalid row of `epoch`."""
    _, name, starts = row
    for table in NUMBERS:
        _start(str(starts), table)
    bytes.fromhex(str(name))
