"""The database file: its tables, and how it is opened."""

import os
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from functools import cache
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.storage.answers import long_work
from gateway.storage.faults import DamagedError, StoreError
from gateway.storage.migration import STEPS, migrate
from gateway.storage.readings import EARLIER, TABLES

SCHEMA_VERSION = 4
_PAGE = 4096
_MAGIC = b"SQLite format 3\0"
_SCHEMA = f"""
CREATE TABLE boot (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, began TEXT NOT NULL,
    config TEXT NOT NULL, fingerprint TEXT NOT NULL,
    versions TEXT NOT NULL);
CREATE TABLE frame (k INTEGER PRIMARY KEY, boot TEXT NOT NULL, inputs BLOB NOT NULL, valid BLOB NOT NULL,
    errors BLOB, sigma BLOB);
CREATE TABLE decision (k INTEGER PRIMARY KEY, phase TEXT NOT NULL, predicted BLOB NOT NULL, corrected BLOB NOT NULL,
    sigma BLOB NOT NULL, limits BLOB NOT NULL, measure TEXT, training TEXT, events TEXT NOT NULL);
CREATE TABLE measurement (id INTEGER PRIMARY KEY, number INTEGER NOT NULL, why TEXT NOT NULL, asked TEXT NOT NULL,
    ended TEXT NOT NULL, centres BLOB, in_force BLOB NOT NULL, errors BLOB, sigma BLOB, residual REAL,
    reason TEXT NOT NULL);
CREATE TABLE model (id INTEGER PRIMARY KEY, after_k INTEGER NOT NULL, fingerprint TEXT NOT NULL, models TEXT NOT NULL);
CREATE TABLE event (id INTEGER PRIMARY KEY, time TEXT NOT NULL, k INTEGER, kind TEXT NOT NULL, text TEXT NOT NULL,
    error TEXT, value REAL, bound REAL);
CREATE TABLE compensation (id INTEGER PRIMARY KEY, time TEXT NOT NULL, mode TEXT NOT NULL, source TEXT NOT NULL,
    k INTEGER, target BLOB NOT NULL, offsets BLOB NOT NULL, positions TEXT NOT NULL, written INTEGER NOT NULL,
    read_back BLOB, coefficients BLOB NOT NULL);
{TABLES}
"""
MARK = int.from_bytes(b"TAL") << 8 | SCHEMA_VERSION
"""Also in the file's header, as its application: the version a second time, as a bit may flip in it."""
READABLE = (3, SCHEMA_VERSION)
"""Versions that can be read without migrating them."""
_CHECKPOINT_PAGES = 2000
"""Largest size of the log (8 MB): pages that are written again and again reach the database's file once in that
time."""

ADDED = """
CREATE TABLE IF NOT EXISTS running (id INTEGER PRIMARY KEY, boot INTEGER NOT NULL, began TEXT NOT NULL,
    config TEXT NOT NULL, fingerprint TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS request (number INTEGER NOT NULL, asked TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS trust (k INTEGER PRIMARY KEY, trusted BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS reasons (k INTEGER PRIMARY KEY, time REAL NOT NULL, reasons TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS computer (slot INTEGER PRIMARY KEY, run TEXT NOT NULL, origin TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS prior (hash TEXT PRIMARY KEY, content TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS prior_of_boot (boot INTEGER PRIMARY KEY, hash TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS snapshot (slot INTEGER PRIMARY KEY, k INTEGER NOT NULL, taken TEXT NOT NULL,
    state BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS moment (slot INTEGER PRIMARY KEY, k INTEGER NOT NULL, origin TEXT NOT NULL,
    monotonic_s REAL NOT NULL, lead_s REAL NOT NULL, known INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS learnt (slot INTEGER PRIMARY KEY, imported TEXT NOT NULL, content TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS pause (k INTEGER PRIMARY KEY, origin TEXT NOT NULL, begin_known INTEGER NOT NULL,
    known INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS epoch (number INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, starts TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS command (id INTEGER PRIMARY KEY, time TEXT NOT NULL, name TEXT NOT NULL, by TEXT NOT NULL,
    accepted INTEGER NOT NULL, text TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS recent_minute (id INTEGER PRIMARY KEY, channel INTEGER NOT NULL, time INTEGER NOT NULL,
    count INTEGER NOT NULL, mean REAL NOT NULL);
CREATE TABLE IF NOT EXISTS gathered (id INTEGER PRIMARY KEY, above INTEGER NOT NULL, upto INTEGER NOT NULL,
    last INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS reading_block (id INTEGER PRIMARY KEY, above INTEGER NOT NULL, upto INTEGER NOT NULL,
    rows INTEGER NOT NULL, first REAL NOT NULL, last REAL NOT NULL, time BLOB NOT NULL, channel BLOB NOT NULL,
    value BLOB NOT NULL, quality BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS thinned (name TEXT PRIMARY KEY, upto INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS coded (id INTEGER PRIMARY KEY, text TEXT NOT NULL UNIQUE, code TEXT NOT NULL,
    content TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS event_kind ON event (kind);
"""
"""Tables that later programs added; in a file without them there is nothing yet that they would contain."""
NEW = f"BEGIN;{_SCHEMA}{ADDED}PRAGMA user_version = {SCHEMA_VERSION};PRAGMA application_id = {MARK};COMMIT;"
"""Makes all tables of a new file in one transaction: a power cut leaves either no table or all of them."""

EXPORTED = {
    "reading": "readings", EARLIER: "readings", "minute": "minutes", "frame": "steps", "measurement": "measurements",
    "model": "models", "event": "events", "compensation": "compensation", "command": "commands", "boot": "runs",
    "reasons": "reasons",
}  # fmt: skip
"""Each table whose rows are exported, and as what."""
_PART_OF = {"decision": "steps", "trust": "steps", "reading_block": "readings", "recent_minute": "readings"}
"""What is stored beside them."""

UNREADABLE = (sqlite3.Error, UnicodeDecodeError)
"""What reading a damaged file raises: SQLite's own messages may contain what is in it."""


def shown_as(table: str) -> str:
    """What people are told that a table is; `other`: only the gateway uses it."""
    return EXPORTED.get(table, _PART_OF.get(table, "other"))


def connect(path: Path, patience_s: float = 10.0) -> sqlite3.Connection:
    """A connection for writing, which waits this long for another program's lock.

    In WAL mode, `synchronous = NORMAL` syncs only at checkpoints: a power cut then loses minutes of commits. FULL syncs
    the log at each commit, about one write per `commit_s`, and loses at most what was not committed.
    """
    connection = sqlite3.connect(path, timeout=patience_s)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA wal_autocheckpoint = {_CHECKPOINT_PAGES}")
    except UNREADABLE:  # not a database, or locked: the caller says which
        connection.close()
        raise
    return connection


def is_damage(error: BaseException) -> bool:
    """Whether this was raised because of what the file holds."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:  # Python's own error for bytes that are not a text has none
        return isinstance(error, UnicodeDecodeError | DamagedError | sqlite3.OperationalError)
    return code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def unusable(path: Path, error: Exception) -> StoreError:
    """What to say of a file that SQLite could not open or read."""
    if is_damage(error):
        if looks_like_a_database(path):
            return DamagedError(Text(NoticeCode.DATABASE_IS_DAMAGED, path=str(path), found=str(error)))
        return StoreError(f"{path}: is not a database of this gateway: {error}")
    if not os.access(path.parent, os.W_OK):
        remedy = f"the folder {path.parent} cannot be written, and SQLite needs two files beside the database"
        return StoreError(f"{path}: cannot be opened: {remedy}; copy it to another folder, or allow writing")
    return StoreError(f"{path}: cannot be opened: {error}")


def looks_like_a_database(path: Path) -> bool:
    """Whether a file that SQLite does not take for a database can be one with a damaged first page."""
    size = path.stat().st_size
    if size > 0 and size % _PAGE == 0:
        return True
    with path.open("rb") as file:  # it may end within a page
        begin = file.read(2 * _PAGE)
    return begin.startswith(_MAGIC[: len(begin)] or _MAGIC) or b"CREATE TABLE boot" in begin


def _columns_of(connection: sqlite3.Connection, table: str) -> set[str]:
    return {str(name) for _, name, *_ in connection.execute(f"PRAGMA table_info({table})")}


@cache
def _expected_columns() -> Mapping[str, set[str]]:
    """The columns of each table."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(NEW)
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        return {table: _columns_of(connection, table) for (table,) in tables}


def _check_columns(path: Path, connection: sqlite3.Connection) -> None:
    """A bit may flip in the name of a column, too."""
    for table, names in _expected_columns().items():
        if (found := _columns_of(connection, table)) != names:
            other = ", ".join(sorted(found ^ names))
            raise DamagedError(f"{path}: table {table} has other columns than this program made: {other}")


def _version_of(path: Path) -> tuple[int, int]:
    """Schema version and mark of a file that this program may write; 0 and 0: a new one. Raises StoreError.

    On a connection of its own: `connect` changes the file, whosever it is.
    """
    with closing(sqlite3.connect(path, timeout=10.0)) as connection:
        version, mark = (connection.execute(f"PRAGMA {n}").fetchone()[0] for n in ("user_version", "application_id"))
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    if mark == MARK and version != SCHEMA_VERSION:
        raise DamagedError(f"{path}: states schema version {version}, but was written with another")
    if tables and (version == 0 or (mark >> 8 != MARK >> 8 and "boot" not in tables)):
        raise StoreError(f"{path}: is the database of another program; give [storage] another path")
    if version not in (0, SCHEMA_VERSION, *STEPS):
        raise StoreError(
            f"{path}: schema version {version}, this program supports {SCHEMA_VERSION}; use a newer program, or move "
            "the file away to start a new one"
        )
    return version, mark


def make_schema(path: Path) -> Path | None:
    """Make the tables in a new file; bring those of an earlier version to this one. Another program's file stays as it
    is.

    Returns the backup of what was migrated. Raises StoreError.
    """
    backup = None
    try:
        version, mark = _version_of(path)
        with closing(connect(path)) as connection:
            if version == 0:
                connection.executescript(NEW)
                return None
            if version in STEPS:
                with long_work():
                    backup = migrate(path, connection, version)
            connection.executescript(ADDED)
            _check_columns(path, connection)
            if mark == 0:
                connection.execute(f"PRAGMA application_id = {MARK}")
    except UNREADABLE as error:
        raise unusable(path, error) from error
    return backup
