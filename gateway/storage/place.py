"""Checks that the database is still at its path, and that neither it nor its log has been cut."""

import os
import struct
from contextlib import suppress
from math import inf
from os.path import samestat
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.storage.faults import DamagedError, GoneError

_MAGIC = b"SQLite format 3\0"
_HEADER = 100
_PAGE_SIZE_AT = 16
"""Big-endian number of two bytes; a page of 65,536 bytes is written as 1."""
_PAGES_AT = 28
"""Big-endian number of four bytes."""
_INDEX = struct.Struct("=12xBxHI")
"""Of the log's index, as SQLite keeps it in memory that programs share: whether it is made, page size, frames."""
_INDEX_HEADER = 48
_LOG_HEADER, _FRAME_HEADER = 32, 24
_LOG_MAGIC = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")


class PlaceWatch:
    """Watches the place of a file that is open from now on.

    Whatever is written to a file that is deleted is lost in the end. SQLite does not notice either that another program
    cuts the file: it reads the log and its memory, and its next checkpoint writes around what is missing.

    Raises FileNotFoundError.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._seen = path, path.stat()

    def look(self) -> None:
        """Raises GoneError or DamagedError. A `stat` and a look at the log, unless the file has become smaller.

        A file that is smaller than its header says has not necessarily been cut: a checkpoint beside a reader leaves
        out pages that have changed again, and the last one may be among them. Nor has one that becomes smaller: VACUUM
        does that.
        """
        before = self._seen
        try:
            self._seen = self._path.stat()
        except FileNotFoundError:
            raise GoneError(Text(NoticeCode.DATABASE_DELETED)) from None
        if not samestat(before, self._seen):
            raise GoneError(Text(NoticeCode.DATABASE_EXCHANGED))
        if self._seen.st_size < before.st_size and self._seen.st_size < _expected_size(self._path):
            raise DamagedError(Text(NoticeCode.DATABASE_CUT, bytes=self._seen.st_size))
        check_log(self._path)


def check_log(path: Path) -> None:
    """Whether the log holds what its index says, as long as this process has the database open.

    SQLite would go on behind the end that it remembers, and its next checkpoint would copy the zeros between. A program
    that empties the log in order empties the index before.

    Raises DamagedError.
    """
    with suppress(OSError):
        if (index := _index_of(path)) is not None:
            _compare(index, path, NoticeCode.DATABASE_LOG_CUT)


def check_left(path: Path) -> None:
    """What an earlier run left, before this process opens the database: SQLite takes the rest of a page that was cut
    for zeros, and after a kill a log that was cut for one that ends there, as it makes the index anew. Both are removed
    in order or not at all: an empty log without its index has lost what it held.

    Raises DamagedError.
    """
    with suppress(OSError):
        if _index_of(path) is None:
            log, size = path.with_name(path.name + "-wal"), path.stat().st_size
            expected = _expected_size(path)
            if size < expected < inf and not (log.exists() and log.stat().st_size):  # nor is the rest in the log
                raise DamagedError(Text(NoticeCode.DATABASE_LEFT_CUT, bytes=size, expected=expected))
            beside = path.with_name(path.name + "-shm")
            if not beside.exists() and not log.stat().st_size:
                raise DamagedError(Text(NoticeCode.DATABASE_LOG_LEFT_CUT, bytes=0, expected=_LOG_HEADER))
            with beside.open("rb") as index:
                _compare(index.fileno(), path, NoticeCode.DATABASE_LOG_LEFT_CUT)


def _compare(index: int, path: Path, cut: NoticeCode) -> None:
    before = os.pread(index, _INDEX_HEADER, 0)
    if len(before) < _INDEX_HEADER:
        return
    made, page, frames = _INDEX.unpack_from(before)
    if not made or not frames:
        return
    expected = _LOG_HEADER + frames * (_FRAME_HEADER + (page & 0xFE00) + ((page & 1) << 16))
    with path.with_name(path.name + "-wal").open("rb") as log:
        size, begin = os.fstat(log.fileno()).st_size, log.read(4)
    whole = size >= expected and begin in _LOG_MAGIC
    if not whole and os.pread(index, _INDEX_HEADER, 0) == before:
        raise DamagedError(Text(cut, bytes=size, expected=expected))


def _index_of(path: Path) -> int | None:
    """SQLite's own descriptor of the index: to close another one of the same file would release its locks."""
    wanted = path.resolve().with_name(path.resolve().name + "-shm")
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if descriptor.readlink() == wanted:
                return int(descriptor.name)
    return None


def _expected_size(path: Path) -> float:
    """The size that its header states; infinite if the file does not begin like a database."""
    with path.open("rb") as file:
        header = file.read(_HEADER)
    if len(header) < _HEADER or not header.startswith(_MAGIC):
        return inf
    page = int.from_bytes(header[_PAGE_SIZE_AT : _PAGE_SIZE_AT + 2], "big")
    return (65536 if page == 1 else page) * int.from_bytes(header[_PAGES_AT : _PAGES_AT + 4], "big")
