"""The machines of a site in PostgreSQL, read only: a collector may write to it meanwhile."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import psycopg
import pyarrow as pa
from psycopg.rows import dict_row

from gateway.listeners.collect.database import (
    DatabaseConnection,
    connect_to,
    database_parameters,
    places_of,
    what_is_wrong,
)
from gateway.listeners.collect.folder import CollectError
from gateway.listeners.collect.machines import RUN_FIELDS, CollectedMachine, machine_of
from gateway.listeners.collect.relations import OTHER, quoted, relation_columns

_NUMBERS = ("double precision", "bigint")
_BEGUN = """
    SELECT machine, places::text FROM talc.progress WHERE places ? 'runs' OR jsonb_typeof(places) <> 'object'
    ORDER BY machine
"""
_DAYS = "SELECT DISTINCT time::date FROM talc.steps WHERE machine = %s ORDER BY 1"
_DAY = """
    SELECT {columns} FROM talc.steps WHERE machine = %(machine)s AND time >= %(begin)s AND time < %(end)s
    ORDER BY array_position(%(epochs)s::text[], epoch) NULLS FIRST
"""
"""Rows that are there twice are in different epochs. Those that the progress no longer knows came before all others."""
_ONE_DAY = timedelta(days=1)
_Connect = Callable[[], AbstractContextManager[DatabaseConnection]]


def machines_in_database(url: str, password_file: Path | None = None) -> list[CollectedMachine]:
    """Every machine of a database of `talc-gateway collect`.

    Raises ValueError for an address that is invalid or holds a password; CollectError if the database cannot be
    reached, or contains no run of any machine that can be read.
    """
    read = partial(_reading, database_parameters(url), password_file)
    with read() as connection:
        there = all(relation_columns(connection, table) for table in ("progress", "runs", "steps"))
        begun = connection.execute(_BEGUN).fetchall() if there else []
        if not begun:
            raise CollectError(f"{url}: contains no run of any machine; give a database of `talc-gateway collect`")
        return [_machine(connection, name, places, read) for name, places in begun]


def _machine(connection: DatabaseConnection, name: str, places_text: str, read: _Connect) -> CollectedMachine:
    known = relation_columns(connection, "runs")
    texts = (quoted(name) if name in known else f"{OTHER}->>'{name}' AS {quoted(name)}" for name in RUN_FIELDS)
    query = f"SELECT {', '.join(texts)} FROM talc.runs WHERE machine = %s"
    runs = connection.cursor(row_factory=dict_row).execute(query.encode(), (name,)).fetchall()
    try:
        places = places_of(name, places_text)
        epochs = [epoch for epoch, _ in places.get("steps", ())]
        return machine_of(name, runs, places.get("runs", ()), partial(_days, read, name, epochs))
    except ValueError as error:
        raise CollectError(
            f"database: talc.runs, machine {name}: its latest run cannot be read: {error}; collect this machine again"
        ) from error


def _days(read: _Connect, machine: str, epochs: list[str], names: Sequence[str]) -> Iterator[pa.Table]:
    with read() as connection:
        known = relation_columns(connection, "steps")
        columns = ", ".join(_column(name, known) for name in names)
        query = _DAY.format(columns=columns).encode()
        for (day,) in connection.execute(_DAYS, (machine,)).fetchall():
            span = {"machine": machine, "begin": day, "end": day + _ONE_DAY, "epochs": epochs}
            rows = connection.execute(query, span).fetchall()
            values = zip(*rows, strict=True)
            yield pa.table(
                [_array(name, list(column)) for name, column in zip(names, values, strict=True)], list(names)
            )


def _column(name: str, known: Mapping[str, str]) -> str:
    """An expression for a column, with what its table has no place for."""
    if name == "time":
        return name
    text = name.replace("'", "''").replace("%", "%%")
    other = f"({OTHER}->>'{text}')::double precision"
    if known.get(name) not in _NUMBERS:
        return other
    own = quoted(name).replace("%", "%%")
    return own if name == "k" else f"coalesce({own}::double precision, {other})"


def _array(name: str, values: list[Any]) -> pa.Array:
    if name == "time":
        return pa.array(values, pa.timestamp("us", tz="UTC"))
    return pa.array(values, pa.int64() if name == "k" else pa.float64())


@contextmanager
def _reading(parameters: Mapping[str, Any], password_file: Path | None) -> Iterator[DatabaseConnection]:
    """A connection that changes nothing, and leaves the collector's lock alone."""
    try:
        with connect_to(parameters, password_file) as connection:
            connection.read_only = True
            connection.execute("SET TIME ZONE 'UTC'")
            yield connection
    except psycopg.Error as error:
        raise CollectError(f"database: {what_is_wrong(error)}") from error
