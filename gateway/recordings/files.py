"""Reads tables chunk by chunk: CSV as loggers and spreadsheets write it, and Parquet."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gateway.config import Problem
from gateway.recordings.problems import FileProblems, RecordingError

if TYPE_CHECKING:
    import pyarrow

_CHUNK_ROWS = 4096
_PARQUET = b"PAR1"
_SQLITE = b"SQLite format 3\0"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}


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

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        """All rows of the time's column and of others."""
        ...


def is_database(path: Path) -> bool:
    """Whether the file is a gateway's store."""
    with path.open("rb") as file:
        return file.read(len(_SQLITE)) == _SQLITE


def open_table(path: Path) -> FileTable:
    """The kind of file, by its content. Raises RecordingError if it is neither."""
    with path.open("rb") as file:
        parquet = file.read(len(_PARQUET)) == _PARQUET
    return _Parquet(path) if parquet else _Csv(path)


class _Csv:
    """Comma, semicolon (then with a decimal comma too) or tab, whichever the heading contains most."""

    word = "line"

    def __init__(self, path: Path) -> None:
        self._path = path
        _check_text(path)
        with path.open(encoding="utf-8-sig", newline="") as file:
            heading = file.readline()
        self._delimiter = max(",;\t", key=heading.count)
        try:
            head = next(csv.reader([heading], delimiter=self._delimiter, strict=True), [])
        except csv.Error as error:
            raise RecordingError(path, [Problem("line 1", _unreadable(error))]) from None
        self.head = [name.strip() for name in head]
        if not any(self.head):
            raise RecordingError(path, [Problem("", "is empty; expected a heading and lines below it")])

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        wanted = [self.head.index(name) for name in (time, *names)]
        places: list[int] = []
        rows: list[list[str]] = []
        for line, row in self._rows(problems):
            if len(row) != len(self.head):
                problems.add(f"line {line}", f"{len(row)} cells; the heading has {len(self.head)}")
                continue
            cells = [row[i].strip() for i in wanted]
            rows.append([cell.replace(",", ".") for cell in cells] if self._delimiter == ";" else cells)
            places.append(line)
            if len(rows) == _CHUNK_ROWS:
                yield _chunk(places, rows)
                places, rows = [], []
        if rows:
            yield _chunk(places, rows)

    def _rows(self, problems: FileProblems) -> Iterator[tuple[int, list[str]]]:
        """Line on which each row begins, and its cells; empty lines are skipped."""
        with self._path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, delimiter=self._delimiter, strict=True)
            next(reader)
            while True:
                line = reader.line_num + 1
                try:
                    row = next(reader, None)
                except csv.Error as error:  # the cells after it cannot be separated
                    problems.add(f"line {line}", _unreadable(error))
                    return
                if row is None:
                    return
                if reader.line_num > line and len(row) != len(self.head):
                    problems.add(f"line {line}", _unreadable(f"it ends on line {reader.line_num}"))
                    return
                if any(cell and not cell.isspace() for cell in row):
                    yield line, row


def _chunk(places: list[int], rows: list[list[str]]) -> Chunk:
    time, *columns = zip(*rows, strict=True)
    return Chunk(places, time, columns)


def _unreadable(why: object) -> str:
    return f'cannot be split into cells: is there a quote (") that is opened but not closed? ({why})'


def _check_text(path: Path) -> None:
    """Raises RecordingError with the line of the first byte that is not UTF-8."""
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                if number == 1 and line.startswith(_UTF16):
                    raise RecordingError(path, [Problem("", "is UTF-16 text; save it as UTF-8")]) from None
                byte = f"byte {error.start + 1} of the line is {line[error.start]:#04x}"
                what = f"is neither Parquet nor UTF-8 text: {byte}; save the table as CSV UTF-8"
                raise RecordingError(path, [Problem(f"line {number}", what)]) from None


class _Parquet:
    """Needs pyarrow, but not the optional packages that pyarrow uses for times."""

    word = "row"

    def __init__(self, path: Path) -> None:
        try:
            from pyarrow import ArrowException, parquet
        except ImportError:
            what = "Parquet needs pyarrow: install talc-gateway with the extra `parquet`, or save the table as CSV"
            raise RecordingError(path, [Problem("", what)]) from None
        try:
            self._table: pyarrow.Table = parquet.read_table(path)
            self.head: list[str] = self._table.column_names
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise RecordingError(path, [Problem("", f"is not a readable Parquet file: {error}")]) from None
        if not any(self.head):
            raise RecordingError(path, [Problem("", "has no column with a name")])

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        usable = [self._is_plain(name, problems) for name in names]
        if not all(usable):
            return
        for start in range(0, self._table.num_rows, _CHUNK_ROWS):
            part = self._table.slice(start, _CHUNK_ROWS)
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
