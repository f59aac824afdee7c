"""A copy of a database, also while a gateway writes to it."""

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.storage.damage import checked_columns
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.schema import NEW, SCHEMA_VERSION

_RAW = {"reading": "readings", "minute": "minutes"}
"""Tables of raw readings, and what they are called outside the database."""


def back_up(database: Path, output: Path, *, readings: bool = True) -> None:
    """Copy it to a file, which appears once it is complete. Raises StoreError, OSError.

    readings: also the raw readings and their means, which are nearly all of it and of which nothing is learnt
    """
    part = output.with_name(output.name + ".part")
    part.unlink(missing_ok=True)
    try:
        with History(database), closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(part)) as target:
            if readings:
                source.backup(target)
                target.execute("PRAGMA journal_mode = DELETE")
            else:
                _copy_without_readings(database, target)
        part.rename(output)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _copy_without_readings(database: Path, target: sqlite3.Connection) -> None:
    """Of the raw readings the newest remains, so that numbers go on, and how many are missing."""
    target.execute("ATTACH ? AS source", (str(database),))
    (version,) = target.execute("PRAGMA source.user_version").fetchone()
    if version != SCHEMA_VERSION:
        raise StoreError(Text(NoticeCode.DATABASE_EARLIER, path=str(database), version=version))
    target.executescript(NEW)
    with target:
        target.execute("BEGIN")  # one state of the source
        there = {name for (name,) in target.execute("SELECT name FROM source.sqlite_master WHERE type = 'table'")}
        for table in (*checked_columns(), "thinned"):
            if table in there:
                names = ", ".join(name for _, name, *_ in target.execute(f"PRAGMA main.table_info({table})"))
                target.execute(f"INSERT INTO main.{table} ({names}) SELECT {names} FROM source.{table}")
        for table, name in _RAW.items():
            newest = f"FROM source.{table} ORDER BY id DESC LIMIT 1"
            target.execute(f"INSERT INTO main.{table} SELECT * {newest}")
            target.execute(f"INSERT OR REPLACE INTO main.thinned SELECT '{name}', id - 1 {newest}")
