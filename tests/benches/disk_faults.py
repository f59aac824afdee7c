"""The faults that a disk is given, and what becomes of a gateway's life with one."""

import errno
from dataclasses import dataclass, field

HANGS_ONCE = -2
"""The error of a disk that only takes long, once (failing_disk.cc)."""


@dataclass(frozen=True, slots=True)
class DiskFault:
    """What the disk does."""

    name: str
    error: int
    lasting: bool = False
    hang_ms: int = 0


FAULTS = (
    DiskFault("ENOSPC, lasting", errno.ENOSPC, lasting=True),
    DiskFault("EIO, lasting", errno.EIO, lasting=True),
    DiskFault("EROFS, lasting", errno.EROFS, lasting=True),
    DiskFault("ENOSPC, once", errno.ENOSPC),
    DiskFault("EIO, once", errno.EIO),
)


@dataclass(slots=True)
class LifeVerdict:
    """What became of one life."""

    calls: str = ""
    """The first letter of each call that changed the disk."""
    refused: int = 0
    """Calls that failed."""
    not_started: int = 0
    told_lost: int = 0
    """Rows that were reported as not stored at a stop."""
    unstored: int = 0
    """Steps that ended while nothing could be stored."""
    states_seen: int = 0
    """How often nothing could be stored while there was something to correct."""
    wrong: list[str] = field(default_factory=list)
