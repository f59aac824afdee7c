"""What was learnt, beside the database: two generations, each with its checksum, for when the database has lost it."""

from contextlib import suppress
from pathlib import Path

from drivers.bounded_file import bytes_of
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.whole_file import write_whole
from gateway.storage.faults import DamagedError
from gateway.storage.learnt import Learnt, learnt_text, parse_learnt

_MOST_BYTES = 2**27
_LEAST_BYTES = 16
"""SQLite takes an empty file for a new one."""


def generations(database: Path) -> tuple[Path, Path]:
    """The files, the newer one first; as `talc-gateway db import-learnt` takes them."""
    return database.with_name(f"{database.name}.learnt"), database.with_name(f"{database.name}.learnt.1")


def write_outside(database: Path, learnt: Learnt) -> None:
    """Write the newer generation; what it was becomes the older one. A power cut leaves one of them whole.

    Raises OSError.
    """
    newer, older = generations(database)
    write_whole(newer, learnt_text(learnt), before=older)


def check_emptied(database: Path) -> None:
    """Raises DamagedError for a file without content beside a copy of what was learnt."""
    with suppress(OSError):
        size = database.stat().st_size
        if size < _LEAST_BYTES and any(path.exists() for path in generations(database)):
            raise DamagedError(Text(NoticeCode.DATABASE_EMPTIED, bytes=size))


def newest_outside(database: Path) -> tuple[str, Learnt] | None:
    """Text and content of the newest generation that is whole; None: none is."""
    for path in generations(database):
        with suppress(OSError, ValueError):
            text = bytes_of(path, _MOST_BYTES).decode()
            return text, parse_learnt(text)
    return None
