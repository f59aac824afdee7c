"""Migrates a database of an earlier schema to the present one, in place, after a backup."""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from gateway.storage.readings import EARLIER, TABLES

_RAW = "sample"
"""No migration changes raw readings, so they need no backup."""

_NUMBERED_BOOTS = """
ALTER TABLE boot RENAME TO boot_before;
CREATE TABLE boot (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, began TEXT NOT NULL,
    config TEXT NOT NULL, fingerprint TEXT NOT NULL, versions TEXT NOT NULL);
INSERT INTO boot SELECT NULL, id, began, config, fingerprint, versions FROM boot_before ORDER BY began, rowid;
DROP TABLE boot_before;
CREATE INDEX IF NOT EXISTS compensation_time ON compensation (time);
"""
_COEFFICIENTS = "ALTER TABLE compensation ADD COLUMN coefficients BLOB NOT NULL DEFAULT x'';"
_THIN_READINGS = f"""
DROP INDEX IF EXISTS sample_time;
ALTER TABLE {_RAW} RENAME TO {EARLIER};
DROP INDEX IF EXISTS compensation_time;
{TABLES}
"""

STEPS: Mapping[int, str] = {1: _NUMBERED_BOOTS, 2: _COEFFICIENTS, 3: _THIN_READINGS}
"""By the version that they start from; each leads to the next one."""


def migrate(path: Path, connection: sqlite3.Connection, version: int) -> Path:
    """Migrate from a version that STEPS has, in one transaction, after a backup, whose path is returned.

    Raises sqlite3.Error; the database is then as it was.
    """
    backup = _back_up(path, version)
    last = max(STEPS) + 1
    steps = "".join(STEPS[number] for number in range(version, last))
    try:
        connection.executescript(f"BEGIN;{steps}PRAGMA user_version = {last};COMMIT;")
    except sqlite3.Error:
        if connection.in_transaction:
            connection.rollback()
        raise
    return backup


def _back_up(path: Path, version: int) -> Path:
    """Copy all tables but the raw readings to a file that appears only when it is whole."""
    backup = path.with_name(f"{path.name}.version{version}")
    part = backup.with_name(backup.name + ".part")
    part.unlink(missing_ok=True)
    with closing(sqlite3.connect(part)) as target:
        target.execute("ATTACH ? AS source", (str(path),))
        target.execute("BEGIN")
        found = target.execute("SELECT type, name, sql FROM source.sqlite_master WHERE sql IS NOT NULL").fetchall()
        for kind in ("table", "index"):
            for _, name, text in (row for row in found if row[0] == kind):
                target.execute(text)
                if kind == "table" and name != _RAW:
                    target.execute(f'INSERT INTO main."{name}" SELECT * FROM source."{name}"')
        target.execute(f"PRAGMA user_version = {version}")
        target.commit()
    part.replace(backup)
    return backup
