"""Finds damage in a database, page by page and row by row.

Damage is what SQLite finds (a page that is not one, a file that is not a database) and rows that are not values of this
gateway. SQLite keeps no checksums of its pages: a bit that flips within a number changes the number.
"""

import json
import sqlite3
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gateway.config.extended import stored_configuration
from gateway.config.outline import inputs_of_config
from gateway.storage import rows
from gateway.storage.epochs import check_epoch
from gateway.storage.learnt import parse_learnt
from gateway.storage.schema import NEW, UNREADABLE, shown_as
from gateway.storage.snapshot import marks_of

_MOST_PAGES = 20
"""So many findings of SQLite are told."""
_NOT_COPIED = ("reading", "minute", "mark", "thinned", "recent_minute", "gathered", "reading_block")
"""Raw readings stay in a file that is set aside: they are many, and nothing is learnt from them."""
_LARGEST = 1e9
"""Largest magnitude of any input, error or uncertainty."""
_LONGEST_S = 1e11
_LAST_K = 1e13
"""Largest grid index. It counts steps since 1970, and a step may be short: one of a second has passed 1.7e9."""

RawRow = tuple[Any, ...]


def contradiction(connection: sqlite3.Connection) -> str:
    """The first thing in which the pages and the indices of a table contradict each other; "" if they do not.

    The raw readings are not looked at: they are many, and nothing is learnt from them. Raises sqlite3.Error.
    """
    for table in checked_columns():
        (found,) = connection.execute(f"PRAGMA integrity_check({table})").fetchone()
        if found != "ok":
            return f"{shown_as(table)}: {found}"
    return ""


def unreadable_rows(path: Path) -> int:
    """How many rows are not values of this gateway, plus one for pages that contradict each other.

    Raises sqlite3.Error or UnicodeDecodeError where SQLite finds damage.
    """
    with closing(sqlite3.connect(path, timeout=10.0)) as source:
        source.text_factory = any_text
        return (
            bool(contradiction(source))
            + _frames_of_no_run(source)
            + sum(
                not is_whole(table, row)
                for table in checked_columns()
                for row in source.execute(f"SELECT * FROM {table}")
            )
        )


def _frames_of_no_run(connection: sqlite3.Connection) -> int:
    """How many frames belong to no run that is stored, or have another number of inputs than it."""
    runs = connection.execute("SELECT id, config FROM boot").fetchall()
    if not runs:
        return 0
    (many,) = connection.execute("SELECT count(*) FROM frame WHERE boot NOT IN (SELECT id FROM boot)").fetchone()
    for boot, text in runs:
        if (inputs := inputs_of_run(text)) is not None:
            found = "SELECT count(*) FROM frame WHERE boot = ? AND length(inputs) <> ?"
            many += connection.execute(found, (boot, 8 * inputs)).fetchone()[0]
    return int(many)


def damage_found(path: Path) -> list[str]:
    """What is damaged, in words, with the raw readings; may be called while a gateway writes to the file."""
    found, bad = list[str](), Counter[str]()
    with closing(sqlite3.connect(path, timeout=10.0)) as source:
        source.text_factory = any_text
        try:
            found += _pages_of_tables(source)
            for table in checked_columns():
                bad[shown_as(table)] += sum(
                    not is_whole(table, row) for row in source.execute(f"SELECT * FROM {table}")
                )
        except UNREADABLE as error:
            found.append(str(error))
    return found + [
        f"{name}: {many} rows hold values that this gateway never writes" for name, many in bad.items() if many
    ]


def _pages_of_tables(source: sqlite3.Connection) -> list[str]:
    """What SQLite finds wrong with the pages, after what the table is."""
    if not (found := _pages(source, str(_MOST_PAGES))):
        return []
    named = list[str]()
    with suppress(*UNREADABLE):
        tables = source.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        for (table,) in (("sqlite_master",), *tables):
            named += [f"{shown_as(table)}: {text}" for text in _pages(source, f'"{table}"')]
    return named[:_MOST_PAGES] or found


def _pages(source: sqlite3.Connection, of: str) -> list[str]:
    try:
        return [str(text) for (text,) in source.execute(f"PRAGMA integrity_check({of})") if text != "ok"]
    except UNREADABLE as error:
        return [str(error)]


def inputs_of_run(config: str) -> int | None:
    """How many inputs a frame of a stored configuration has."""
    try:
        return len(inputs_of_config(config)) or None
    except (AttributeError, ValueError, TypeError, KeyError):
        return None


def is_whole(table: str, row: RawRow) -> bool:
    """Whether the row holds values of this gateway."""
    try:
        for value, (kinds, required) in zip(row, checked_columns()[table], strict=True):
            if not isinstance(value, kinds) and (required or value is not None):
                return False
            if isinstance(value, str):
                value.encode("utf-8")
        _CHECKS.get(table, bool)(row)
    except Exception:  # noqa: BLE001 - whatever a flipped bit makes of it
        return False
    return True


@cache
def checked_columns() -> Mapping[str, Sequence[tuple[tuple[type, ...], bool]]]:
    """The columns of each table that is checked and copied: what a value may be, and whether there must be one."""
    kinds = {"INTEGER": (int,), "REAL": (int, float), "TEXT": (str,), "BLOB": (bytes,)}
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(NEW)
        tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        return {
            table: [
                (kinds[kind], bool(required or key))
                for _, _, kind, required, _, key in connection.execute(f"PRAGMA table_info({table})")
            ]
            for (table,) in tables
            if table not in _NOT_COPIED
        }


def any_text(data: bytes) -> str:
    """The text of any bytes. `is_whole` recognises bytes that were not UTF-8: their text cannot be encoded again."""
    return data.decode("utf-8", "surrogateescape")


_NINE = bytes(72)


def _check_config(text: str) -> None:
    if json.loads(text):  # else nothing was published
        stored_configuration(text)


def _check_frame(row: RawRow) -> None:
    k, _, inputs, valid, errors, sigma = row
    rows.step_of((k, inputs, valid, errors, sigma, "calibration", *[_NINE] * 4, None, None, "[]", None), ())
    if any(blob is not None and len(blob) != len(_NINE) for blob in (errors, sigma)):
        raise ValueError("expected nine errors")
    for blob in (inputs, errors, sigma):
        if blob is not None and np.any(np.abs(np.frombuffer(blob, "<f8")) > _LARGEST):
            raise ValueError("a value is larger than any measurement")
    if sigma is not None and np.any(np.frombuffer(sigma, "<f8") < 0):
        raise ValueError("an uncertainty is negative")


def _check_decision(row: RawRow) -> None:
    k, phase, *blobs, measure, training, events = row
    rows.step_of((k, b"", b"", None, None, phase, *blobs, measure, training, events, None), ())
    if any(len(blob) != len(_NINE) for blob in blobs):
        raise ValueError("expected nine errors")


def _check_measurement(row: RawRow) -> None:
    _, number, why, asked, ended, centres, in_force, errors, _, _, reason = row
    rows.measurement_of((int(number), why, ended, centres, in_force, errors, reason, asked))


def _check_model(row: RawRow) -> None:
    *_, fingerprint, text = row
    if rows.models_of(text).fingerprint() != fingerprint:
        raise ValueError("the fingerprint does not match the models")


def _check_compensation(row: RawRow) -> None:
    _, time, mode, source, _, _, offsets, _, written, *_ = row
    rows.compensation_of((time, mode, source, offsets, written))


def _check_moment(row: RawRow) -> None:
    _, k, _, monotonic_s, lead_s, _ = row
    if not (0 <= k <= _LAST_K and 0.0 <= monotonic_s <= _LARGEST and abs(lead_s) <= _LONGEST_S):
        raise ValueError("the times of the grid step are invalid")


_CHECKS: Mapping[str, Callable[[RawRow], object]] = {
    "boot": lambda row: _check_config(row[3]),
    "running": lambda row: _check_config(row[3]),
    "frame": _check_frame,
    "decision": _check_decision,
    "measurement": _check_measurement,
    "model": _check_model,
    "reasons": lambda row: rows.reasons_of(row[2]),
    "snapshot": lambda row: marks_of(row[3]),
    "event": lambda row: rows.event_of(row[1:]),
    "coded": lambda row: json.loads(row[3]).keys(),
    "command": lambda row: rows.command_of(row[1:]),
    "compensation": _check_compensation,
    "moment": _check_moment,
    "learnt": lambda row: parse_learnt(row[2]),
    "epoch": check_epoch,
}
