"""The interface of a recording's file that is read in chunks of rows, whatever its format."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from gateway.model.text import Text
from gateway.reporting.recordings.problems import FileProblems

CHUNK_ROWS = 4096


@dataclass(frozen=True, slots=True)
class Chunk:
    """Some rows of some columns, as the file has them."""

    places: Sequence[int]
    """Line, or row, of each entry."""
    time: Sequence[object]
    columns: Sequence[Sequence[object]]


class FileTable(Protocol):
    """A file with a heading."""

    head: list[str]
    word: str
    """What its entries are called: `line` or `row`."""
    notes: tuple[Text, ...]
    """What a reader should know of how it was read."""

    def advice(self) -> str:
        """Which lines seem not to belong to the table; empty if none do."""
        ...

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        """All rows of the time's column and of others."""
        ...
