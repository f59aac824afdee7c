"""Methods compared on real recordings, with measurements at the same times (docs/recordings.md)."""

from benchmarks.recordings.subject import is_shipped, rows

__all__ = ["is_shipped", "rows"]
