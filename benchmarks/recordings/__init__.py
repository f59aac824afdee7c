"""Methods compared on real recordings, at equal moments of measurement (docs/benchmark-recordings.md)."""

from benchmarks.recordings.subject import is_shipped, rows

__all__ = ["is_shipped", "rows"]
