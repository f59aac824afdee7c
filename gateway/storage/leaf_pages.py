"""Rows as they stand in the pages of a database file, whatever became of the pages that lead to them.

The format is SQLite's (https://www.sqlite.org/fileformat2.html, sections 1.6 and 2.1).
"""

import mmap
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

PAGE = 4096
_LEAF = 0x0D
_HEADER = 100
"""Bytes before the first page's own."""
_WAL_HEADER, _WAL_FRAME, _SALTS = 32, 24, 8
_LARGEST_LOCAL = PAGE - 35
_LEAST_LOCAL = (PAGE - 12) * 32 // 255 - 23
_SIZES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)
"""Bytes of a value, by its kind."""

PageRow = tuple[int, tuple[Any, ...]]
"""The number of a row, and its values; one that is the row's number itself is None."""


def rows_in_pages(path: Path, wanted: Callable[[Sequence[Any]], bool]) -> Iterator[PageRow]:
    """The rows of all leaf pages in a file and in its log. It may end within a page.

    wanted: whether the rows of a page are, judged by the values of one of them

    Raises OSError.
    """
    with path.open("rb") as file:
        if not file.seek(0, 2):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for page in _pages(data):
                yield from _rows_of(page, data, wanted)
            log = path.with_name(path.name + "-wal")
            for page in _logged(log.read_bytes() if log.exists() else b""):
                yield from _rows_of(page, data, wanted)


def rows_cut_off(path: Path) -> set[PageRow]:
    """The rows that stand only in part on the last page of a file, which ends within it, as SQLite reads them: the rest
    as zeros. Raises OSError."""
    with path.open("rb") as file:
        rest = file.seek(0, 2) % PAGE
        if not rest:
            return set()
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            page = data[-rest:]
            as_zeros, otherwise = (
                set(_rows_of(page + fill, data, lambda _: True))
                for fill in (bytes(PAGE - rest), b"\xff" * (PAGE - rest))
            )
    return as_zeros - otherwise


def _pages(data: mmap.mmap) -> Iterator[bytes]:
    for at in range(0, len(data), PAGE):
        page = data[at : at + PAGE]
        yield page + bytes(PAGE - len(page))


def _logged(log: bytes) -> Iterator[bytes]:
    """The pages of a log that are of its present round."""
    salts = log[16 : 16 + _SALTS]
    for at in range(_WAL_HEADER, len(log) - _WAL_FRAME - PAGE + 1, _WAL_FRAME + PAGE):
        if log[at + 8 : at + 8 + _SALTS] == salts:
            yield log[at + _WAL_FRAME : at + _WAL_FRAME + PAGE]


def _rows_of(page: bytes, data: mmap.mmap, wanted: Callable[[Sequence[Any]], bool]) -> Iterator[PageRow]:
    begin = _HEADER if page.startswith(b"SQLite format 3\0") else 0
    if page[begin] != _LEAF:
        return
    (count,) = struct.unpack_from(">H", page, begin + 3)
    if begin + 8 + 2 * count > PAGE:
        return
    judged = False
    for place in struct.unpack_from(f">{count}H", page, begin + 8):
        with suppress(ValueError, IndexError, struct.error):
            row = _row_at(page, place, data)
            if not judged and not wanted(row[1]):
                return
            judged = True
            yield row


def _row_at(page: bytes, place: int, data: mmap.mmap) -> PageRow:
    """Raises ValueError, IndexError, struct.error."""
    size, place = _varint(page, place)
    number, place = _varint(page, place)
    if size > len(data):
        raise ValueError("a row is larger than the file")
    local = size
    if size > _LARGEST_LOCAL:
        local = _LEAST_LOCAL + (size - _LEAST_LOCAL) % (PAGE - 4)
        local = local if local <= _LARGEST_LOCAL else _LEAST_LOCAL
    record = page[place : place + local]
    if local < size:
        (following,) = struct.unpack_from(">I", page, place + local)
        parts = [record]
        for _ in range(-(-(size - local) // (PAGE - 4))):
            at = (following - 1) * PAGE
            if not 0 < at <= len(data) - PAGE:
                raise ValueError("a row continues outside of the file")
            (following,) = struct.unpack_from(">I", data, at)
            parts.append(data[at + 4 : at + PAGE])
        record = b"".join(parts)[:size]
    if len(record) < size:
        raise ValueError("a row is longer than its page")
    return number - (number >> 63 << 64), tuple(_values(record))


def _values(record: bytes) -> Iterator[Any]:
    header, place = _varint(record, 0)
    at = header
    while place < header:
        kind, place = _varint(record, place)
        size = (kind - 12) // 2 if kind >= 12 else _SIZES[kind]
        part = record[at : at + size]
        if len(part) < size:
            raise ValueError("a value is longer than its row")
        at += size
        if kind == 0:
            yield None
        elif kind >= 12:
            yield part.decode("utf-8", "surrogateescape") if kind % 2 else part
        elif kind == 7:
            yield struct.unpack(">d", part)[0]
        else:
            yield kind - 8 if kind in (8, 9) else int.from_bytes(part, "big", signed=True)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """SQLite's variable-length integer, and what follows it."""
    found = 0
    for i in range(8):
        byte = data[at + i]
        found = found << 7 | byte & 0x7F
        if byte < 0x80:
            return found, at + i + 1
    return found << 8 | data[at + 8], at + 9
