"""The tables of a site in PostgreSQL: made and widened as rows need them."""

from collections.abc import Sequence
from typing import Any

import msgspec
import psycopg
import pyarrow as pa
from pyarrow import compute

from gateway.listeners.collect.tables import time_column

_TYPES = {
    pa.timestamp("us", tz="UTC"): "timestamp with time zone",
    pa.string(): "text",
    pa.float64(): "double precision",
    pa.int64(): "bigint",
}
_MACHINE = "machine"
"""A column that every table has: the machine's name."""
OTHER = "other"
"""Another one: JSON, with what the table has no column for."""
_KEY = ("machine", "epoch", "row")
_KEYS = {"gaps": ("machine", "table", "epoch", "upto")}
"""The columns that identify a row; a hypertable needs the time among them."""
_MOST_COLUMNS = 800
"""Most columns of a table: a row with more numbers does not fit into a page of PostgreSQL."""
_MOST_BYTES = 63
"""Longest name of a column."""
_AT_ONCE = 2000
"""Rows of a statement, as lists of Python objects take memory."""
_CHUNK = "7 days"


class SiteRelations:
    """What is known of the tables in the schema `talc`, within one connection."""

    def __init__(self) -> None:
        self._columns: dict[str, dict[str, str]] = {}
        """By table: names and types."""

    def add(self, connection: "psycopg.Connection[Any]", machine: str, table: str, rows: pa.Table) -> None:
        """Insert rows that are not there yet. Columns that do not fit into the table go to its column `other`.

        Raises ValueError for rows that contradict themselves, psycopg.Error.
        """
        names = rows.column_names
        if len({*names, _MACHINE, OTHER}) != len(names) + 2:
            raise ValueError(f"{table}: a column occurs twice, or is named {_MACHINE} or {OTHER}")
        time = time_column(rows)
        types = {name: _TYPES[rows.schema.field(name).type] for name in names}
        known = self._known(connection, table, types, time)
        own = [name for name in names if known.get(name) == types[name]]
        others = [name for name in names if known.get(name) != types[name]]
        statement = _insert(table, own, types).encode()
        for begin in range(0, rows.num_rows, _AT_ONCE):
            some = rows.slice(begin, _AT_ONCE)
            values = [_values(some[name]) for name in own]
            connection.execute(statement, (machine, *values, _other_values(some.select(others))))

    def _known(
        self, connection: "psycopg.Connection[Any]", table: str, types: dict[str, str], time: str
    ) -> dict[str, str]:
        """Columns of a table after it has got all of these that it can have."""
        known = self._columns.get(table) or relation_columns(connection, table)
        fitting = {name: kind for name, kind in types.items() if len(name.encode()) <= _MOST_BYTES}
        if not known:
            _create(connection, table, fitting, time)
            known = relation_columns(connection, table)
        elif table not in self._columns:
            _index(connection, table, known, time)
        missing = [name for name in fitting if name not in known][: max(0, _MOST_COLUMNS - len(known))]
        if missing:
            added = ", ".join(f"ADD COLUMN {quoted(name)} {fitting[name]}" for name in missing)
            connection.execute(f"ALTER TABLE talc.{quoted(table)} {added}".encode())
            known = relation_columns(connection, table)
        self._columns[table] = known
        return known


def relation_columns(connection: "psycopg.Connection[Any]", table: str) -> dict[str, str]:
    """Names and types; none if there is no such table."""
    query = (
        "SELECT column_name, data_type FROM information_schema.columns WHERE table_schema = 'talc' AND table_name = %s"
    )
    return dict(connection.execute(query, (table,)).fetchall())


def _create(connection: "psycopg.Connection[Any]", table: str, types: dict[str, str], time: str) -> None:
    """A hypertable where TimescaleDB's extension is in the database, otherwise a plain one."""
    place, key = f"talc.{quoted(table)}", _KEYS.get(table, _KEY)
    timescale = connection.execute("SELECT 1 FROM pg_extension WHERE extname = 'timescaledb'").fetchone() is not None
    if timescale and time not in key:
        key = (*key, time)
    first = {name: types[name] for name in (*key, time) if name in types}
    types = dict(list({**first, **types}.items())[:_MOST_COLUMNS])
    columns = ", ".join(f"{quoted(name)} {kind}" for name, kind in {_MACHINE: "text", **types, OTHER: "jsonb"}.items())
    connection.execute(f"CREATE TABLE {place} ({columns}, PRIMARY KEY ({', '.join(map(quoted, key))}))".encode())
    if timescale:
        make = "SELECT create_hypertable(%s::regclass, %s::name, chunk_time_interval => %s::interval)"
        connection.execute(make, (place, time, _CHUNK))
    _index(connection, table, types, time)
    if not timescale:
        connection.execute(f"CREATE INDEX ON {place} USING brin ({quoted(time)})".encode())


def _index(connection: "psycopg.Connection[Any]", table: str, types: dict[str, str], time: str) -> None:
    """For one channel's course of one machine, the question of every dashboard; also of a table of an older program."""
    if "channel" in types:
        name = quoted(f"{table}_{_MACHINE}_channel_{time}_idx")  # PostgreSQL's own name of it
        create = f'CREATE INDEX IF NOT EXISTS {name} ON talc.{quoted(table)} ({_MACHINE}, "channel", {quoted(time)})'
        connection.execute(create.encode())


def _insert(table: str, own: Sequence[str], types: dict[str, str]) -> str:
    columns = ", ".join(map(quoted, (_MACHINE, *own, OTHER)))
    arrays = ", ".join(f"%s::{kind}[]" for kind in (*(types[name] for name in own), "jsonb"))
    begin = f"INSERT INTO talc.{quoted(table)} ({columns})".replace("%", "%%")
    return f"{begin} SELECT %s, * FROM unnest({arrays}) ON CONFLICT DO NOTHING"


def _values(column: pa.ChunkedArray) -> list[Any]:
    """As PostgreSQL takes them: times as text, and no text with a zero byte, which it refuses."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.string())
    elif pa.types.is_string(column.type):
        column = compute.replace_substring(column, "\0", "\ufffd")
    return column.to_pylist()  # type: ignore[no-any-return]


def _other_values(rows: pa.Table) -> list[str | None]:
    """By row: what the table has no column for, as JSON."""
    if not rows.num_columns:
        return [None] * rows.num_rows
    columns = {name: _values(rows[name]) for name in rows.column_names}
    found = []
    for i in range(rows.num_rows):
        there = {name: values[i] for name, values in columns.items() if values[i] is not None}
        found.append(msgspec.json.encode(there).decode() if there else None)
    return found


def quoted(name: str) -> str:
    """As an identifier of SQL."""
    return '"' + name.replace('"', '""') + '"'
