"""Parses the times in messages."""

from datetime import UTC, datetime


def instant(text: str) -> datetime | None:
    """A published time; None: not one."""
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    if not 2000 <= found.year < 2200:
        return None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)
