"""What was learnt, beside the database: two generations, each with its checksum, for when the database has lost it."""

from contextlib import suppress
from pathlib import Path

from drivers.bounded_file import bytes_of
from gateway.runtime.whole_file import write_whole
from gateway.storage.learnt import Learnt, learnt_text, parse_learnt

_MOST_BYTES = 2**27


def generations(database: Path) -> tuple[Path, Path]:
    """The files, the newer one first; as `talc-gateway db import-learnt` takes them."""
    return database.with_name(f"{database.name}.learnt"), database.with_name(f"{database.name}.learnt.1")


def write_outside(database: Path, learnt: Learnt) -> None:
    """Write the newer generation; what it was becomes the older one. A power cut leaves one of them whole.

    Raises OSError.
    """
    newer, older = generations(database)
    write_whole(newer, learnt_text(learnt), before=older)


def newest_outside(database: Path) -> tuple[str, Learnt] | None:
    """Text and content of the newest generation that is whole; None: none is."""
    for path in generations(database):
        with suppress(OSError, ValueError):
            text = bytes_of(path, _MOST_BYTES).decode()
            return text, parse_learnt(text)
    return None
