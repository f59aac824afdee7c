"""Reads tables chunk by chunk: text, and Parquet."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.bounded_file import opened
from drivers.error_words import in_words
from gateway.config.problems import Problem
from gateway.model.text import Text
from gateway.reporting.recordings.chunks import CHUNK_ROWS, Chunk, FileTable
from gateway.reporting.recordings.layout import TextLayout
from gateway.reporting.recordings.problems import FileProblems, RecordingError
from gateway.reporting.recordings.text import TextTable
from gateway.runtime.bounded_memory import memory_left

if TYPE_CHECKING:
    import pyarrow

_PARQUET = b"PAR1"
_SQLITE = b"SQLite format 3\0"
_PLAIN = TextLayout()
_CELL_BYTES = 8
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}


def is_database(path: Path) -> bool:
    """Whether the file is a gateway's store."""
    with opened(path) as file:
        return file.read(len(_SQLITE)) == _SQLITE


def open_table(path: Path, layout: TextLayout = _PLAIN) -> FileTable:
    """The kind of file, by its content. Raises RecordingError if it is neither."""
    with opened(path) as file:
        parquet = file.read(len(_PARQUET)) == _PARQUET
    if parquet and layout.skip:
        raise RecordingError(path, [Problem("", "is Parquet, which has no lines to skip")])
    return _Parquet(path) if parquet else TextTable(path, layout)


class _Parquet:
    """Needs pyarrow, but not the optional packages that pyarrow uses for times."""

    word = "row"
    notes: tuple[Text, ...] = ()

    def __init__(self, path: Path) -> None:
        try:
            from pyarrow import ArrowException, parquet
        except ImportError:
            what = "Parquet needs pyarrow: install talc-gateway with the extra `parquet`, or save the table as CSV"
            raise RecordingError(path, [Problem("", what)]) from None
        try:
            stated = parquet.read_metadata(path)
            if stated.num_rows * stated.num_columns * _CELL_BYTES > memory_left():
                raise MemoryError
            self._table: pyarrow.Table = parquet.read_table(path, use_threads=False, pre_buffer=False)
            self.head: list[str] = self._table.column_names
        except MemoryError:  # Arrow's is one of its own errors, too
            raise
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise RecordingError(path, [Problem("", f"is not a readable Parquet file: {in_words(error)}")]) from None
        if not any(self.head):
            raise RecordingError(path, [Problem("", "has no column with a name")])

    def advice(self) -> str:
        return ""

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        usable = [self._is_plain(name, problems) for name in names]
        if not all(usable):
            return
        for start in range(0, self._table.num_rows, CHUNK_ROWS):
            part = self._table.slice(start, CHUNK_ROWS)
            columns = [part.column(name).to_pylist() for name in names]
            yield Chunk(range(start + 1, start + 1 + part.num_rows), _time_cells(part.column(time)), columns)

    def _is_plain(self, name: str, problems: FileProblems) -> bool:
        from pyarrow import types

        kind: Any = self._table.schema.field(name).type
        if types.is_temporal(kind) or types.is_nested(kind):
            problems.add(f"column {name!r}", f"holds {kind}, not numbers; --ignore {name!r} leaves it out")
            return False
        return True


def _time_cells(column: Any) -> Sequence[object]:
    """Timestamps as seconds, whatever their resolution; the time zone is ignored, because it is only for display."""
    from pyarrow import int64, types

    if not types.is_timestamp(column.type):
        cells: Sequence[object] = column.to_pylist()
        return cells
    parts = _PER_SECOND[column.type.unit]
    return [None if count is None else count / parts for count in column.cast(int64()).to_pylist()]
