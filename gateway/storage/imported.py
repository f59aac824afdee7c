"""Puts what another database had learnt into one that has no record yet."""

import sqlite3
from contextlib import closing, suppress
from datetime import datetime
from pathlib import Path

from gateway.storage import rows
from gateway.storage.faults import StoreError
from gateway.storage.learnt import Learnt
from gateway.storage.lock import FileLock, link_followed
from gateway.storage.schema import connect, make_schema


def import_learnt(path: Path, learnt: Learnt, text: str, now: datetime, *, replace: bool) -> Path | None:
    """Begin a database with what was learnt; the next run continues from it.

    text: of the file that `learnt` is from
    replace: a database with a record is renamed and another one begun; otherwise it is refused

    Returns the new name of the renamed one. Raises StoreError: a gateway runs on it, or it has a record.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path = link_followed(path)
    lock = FileLock(path)
    try:
        aside = None
        if path.exists() and _has_record(path):
            if not replace:
                raise StoreError(
                    f"{path}: has a record, which the import would replace; give [storage] another path, or give "
                    "--replace, which keeps the record under another name"
                )
            aside = path.with_name(f"{path.name}.before-import-{now:%Y%m%dT%H%M%S}")
            for ending in ("-wal", "-shm", ""):
                with suppress(FileNotFoundError):
                    path.with_name(path.name + ending).rename(aside.with_name(aside.name + ending))
        make_schema(path)
        with closing(connect(path)) as connection, connection:
            put_learnt(connection, text, now)
            put_reference(connection, learnt)
    finally:
        lock.release()
    return aside


def put_learnt(connection: sqlite3.Connection, text: str, now: datetime, last_k: int = -1) -> None:
    """Put a file of what was learnt in the place of all steps until a grid index; -1: before the first one."""
    connection.execute("DELETE FROM learnt")
    connection.execute("INSERT INTO learnt VALUES (?, ?, ?)", (last_k + 1, now.isoformat(), text))


def put_reference(connection: sqlite3.Connection, learnt: Learnt) -> None:
    """Put the reference of what was learnt into a database without a record."""
    connection.execute("DELETE FROM measurement")
    if (reference := learnt.reference) is not None:
        # It stays the first measurement, which all others are relative to.
        row = rows.of_reference(reference)
        connection.execute("INSERT INTO measurement VALUES (1, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)


def _has_record(path: Path) -> bool:
    make_schema(path)
    with closing(connect(path)) as connection:
        tables = ("frame", "measurement", "model", "boot")
        many = [connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in tables]
        imported = connection.execute("SELECT count(*) FROM learnt").fetchone()[0]
    return bool(many[0] or many[2] or many[3] or (many[1] and not imported))
