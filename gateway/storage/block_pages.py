"""Stored readings of a span of time as compressed columns, page by page, while a gateway writes.

The store makes a block of the readings of every ten minutes (`gateway.storage.readings`). Blocks within the span are
sent as they are. Only readings that are in no block yet, and blocks of which a part is wanted, are looked at one by
one.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from gateway.model.reading_blocks import BlockColumns, ReadingBlock, pack, pack_columns, unpack
from gateway.storage.pages import PageSpan, channel_ids, minutes_after, place_of, reading_connection, readings_after
from gateway.storage.readings import BLOCK_ROWS

_LAST_ID = 2**63 - 2
_MOST_LOOKED_AT = 2_000_000
"""Readings of blocks of which only some are wanted; when few of them are, the page is short."""


@dataclass(frozen=True, slots=True)
class BlocksPage:
    """Readings in the order in which they were stored."""

    period_s: float
    """0: single readings; 60: means of the good readings of a minute, as older ones are kept."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    numbers: tuple[int, ...]
    """What stands for each channel in a block."""
    blocks: tuple[ReadingBlock, ...]
    next: str | None
    """Where the next page begins; None: this is the last one."""


def blocks_page(
    path: Path, begin: datetime, end: datetime, channels: Sequence[str] | None, limit: int, after: str | None = None
) -> BlocksPage:
    """As `readings_page`, but a page ends with the first block that makes it `limit` readings or more.

    Raises as `readings_page`.
    """
    minutes, last = place_of(after)
    with reading_connection(path) as connection:
        connection.execute("BEGIN")  # readings in blocks and others: as of one moment
        known = connection.execute("SELECT id, name, unit FROM channel ORDER BY id").fetchall()
        wanted = PageSpan(begin.timestamp(), end.timestamp(), channel_ids(known, channels))
        numbers, names, units = zip(*known, strict=True) if known else ((), (), ())
        if minutes:
            rows, following = minutes_after(connection, wanted, min(limit, BLOCK_ROWS), last)
            if len(rows) or following:
                blocks = (pack(rows),) if len(rows) else ()
                return BlocksPage(60.0, names, units, numbers, blocks, f"m{following}" if following else "r0")
        found, following = _taken(connection, wanted, limit, 0 if minutes else last)
        return BlocksPage(0.0, names, units, numbers, found, f"r{following}" if following else None)


def _taken(
    connection: sqlite3.Connection, span: PageSpan, limit: int, last: int
) -> tuple[tuple[ReadingBlock, ...], int | None]:
    """Blocks of the readings after an id, and after which id to go on; None: no more are in the span."""
    found, many, looked_at = list[ReadingBlock](), 0, 0
    for above, upto, number in _pieces(connection, last):
        block, following = None, None
        if number is not None:
            block, number, rows_of_it = _stored(connection, number, span)
            looked_at += rows_of_it
        if number is None:
            rows, following = readings_after(connection, span, min(limit, BLOCK_ROWS), above, upto + 1)
            block = pack(rows) if len(rows) else None
        if block is not None:
            found.append(block)
            many += block.rows
        if following is not None:
            return tuple(found), following
        if (many >= limit or looked_at >= _MOST_LOOKED_AT) and upto < _LAST_ID:
            return tuple(found), upto
    return tuple(found), None


def _pieces(connection: sqlite3.Connection, last: int) -> Iterator[tuple[int, int, int | None]]:
    """The ids after one, without a gap: above which, up to which, and the number of their block; None: none."""
    there = "SELECT count(*) FROM sqlite_master WHERE name = 'reading_block'"
    if connection.execute(there).fetchone()[0]:
        query = "SELECT above, upto, id FROM reading_block WHERE upto > ? ORDER BY upto"
        for above, upto, number in connection.execute(query, (last,)).fetchall():
            if above > last:
                yield last, above, None
            if above >= last:
                yield above, upto, number
            else:  # an earlier page ended within it
                yield last, upto, None
            last = upto
    yield last, _LAST_ID, None


def _stored(connection: sqlite3.Connection, number: int, span: PageSpan) -> tuple[ReadingBlock | None, int | None, int]:
    """What is wanted of a stored block, None: nothing is; its number, None: it is damaged, though its rows may not be;
    and how many readings were looked at."""
    columns = "rows, first, last, time, channel, value, quality"
    found = connection.execute(f"SELECT {columns} FROM reading_block WHERE id = ?", (number,)).fetchone()
    block = ReadingBlock(*found)
    if block.last_s < span.begin_s or block.first_s >= span.end_s:
        return None, number, 0
    if span.channels is None and block.first_s >= span.begin_s and block.last_s < span.end_s:
        return block, number, 0
    try:
        taken = unpack(block)
    except ValueError:
        return None, None, 0
    chosen = (taken.time >= span.begin_s) & (taken.time < span.end_s)
    if span.channels is not None:
        chosen &= np.isin(taken.channel, span.channels)
    wanted = BlockColumns(taken.time[chosen], taken.channel[chosen], taken.value[chosen], taken.quality[chosen])
    return pack_columns(wanted) if chosen.any() else None, number, block.rows
