"""How often the store's thread does what, and how long it waits for the disk."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class WriterTiming:
    """Times of the thread, real seconds."""

    commit_s: float
    """It commits at least this often."""
    retry_s: float = 5.0
    """How long another program's lock is waited for, and how long between two attempts."""
    look_s: float = 10.0
    """How often the disk's free space is read, and whether the file is still at its path, and uncut."""
    prune_s: float = 600.0
    """How often what is too old is deleted."""
    hangs_after_s: float = 30.0
    """A statement or commit that takes longer counts as failing."""
    silent_s: float = 30.0
    """At the end, the longest that the disk may take for one statement or commit."""
