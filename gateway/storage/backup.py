"""A copy of a database, also while a gateway writes to it."""

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from gateway.storage.history import History


def back_up(database: Path, output: Path) -> None:
    """Copy it to a file, which appears once it is complete. Raises StoreError, OSError."""
    part = output.with_name(output.name + ".part")
    try:
        with History(database), closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(part)) as target:
            source.backup(target)
            target.execute("PRAGMA journal_mode = DELETE")
        part.rename(output)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
