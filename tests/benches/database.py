"""Reads a gateway's database with SQL, as others may."""

import sqlite3
from contextlib import closing
from datetime import datetime
from pathlib import Path


def applied(path: Path) -> list[tuple[datetime, str]]:
    """UTC and fingerprint of each configuration that came into use, by a start or a reload; oldest first."""
    with closing(sqlite3.connect(path)) as connection:
        found = connection.execute("SELECT began, fingerprint FROM running ORDER BY id").fetchall()
    return [(datetime.fromisoformat(began), fingerprint) for began, fingerprint in found]
