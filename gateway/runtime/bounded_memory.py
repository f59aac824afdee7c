"""Bounds the memory that reading a file from outside may take: a few bytes of it may stand for gigabytes."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.given import GivenError
from gateway.model.text import Text

_LEAST_BYTES = 150 * 2**20
_TIMES = 12
"""What a file of text may take for each of its bytes: cells as texts, then as numbers."""


class MemoryBoundError(GivenError):
    """The file takes more memory than a file of its size may."""


@contextmanager
def memory_for(path: Path) -> Iterator[None]:
    """Inside, the process may take 150 MiB or twelve times the file's size of memory, whichever is more.

    For a command that does nothing else meanwhile: the bound is the process's. Raises MemoryBoundError.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    more = max(_LEAST_BYTES, _TIMES * path.stat().st_size)
    most = data_bytes() + more
    if before[0] == resource.RLIM_INFINITY or most < before[0]:
        resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
    try:
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_DATA, before)
    except MemoryError:
        raise MemoryBoundError(Text(NoticeCode.FILE_TAKES_MEMORY, path=str(path), most_mb=more >> 20)) from None


def memory_left() -> float:
    """Bytes that the process may still take; infinite without a bound."""
    most, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return float("inf") if most == resource.RLIM_INFINITY else most - data_bytes()


def address_space_left() -> float:
    """Bytes of addresses that the process may still take (`ulimit -v`); infinite without a bound."""
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if most == resource.RLIM_INFINITY else most - _bytes(0)


def data_bytes() -> int:
    """What the kernel counts as this process's data."""
    return _bytes(5)


def _bytes(column: int) -> int:
    """Of /proc/self/statm."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()
    return int(pages[column]) * os.sysconf("SC_PAGE_SIZE")
