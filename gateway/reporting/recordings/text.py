"""Reads tables of text as loggers and spreadsheets write them: encoding, separator, decimal comma, lines left out."""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from gateway.config.problems import Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.reporting.recordings.advice import advice_on
from gateway.reporting.recordings.chunks import CHUNK_ROWS, Chunk
from gateway.reporting.recordings.layout import TextLayout, ranges_text
from gateway.reporting.recordings.problems import FileProblems, RecordingError

_SEPARATORS = ",;\t"
_DECIMAL_COMMA = ";\t "
"""Separators with which a comma in a number is a decimal one."""
_EXCEL = re.compile(r'"?sep=(.)"?\s*')
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_MARKS = ((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
"""Byte order marks, and what they say."""
_BOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""Beginnings of the workbooks of Excel and LibreOffice."""
_WINDOWS = "cp1252"


class TextTable:
    """Comma, semicolon, tab or spaces, whichever the heading contains most; all but the comma allow a decimal comma."""

    word = "line"

    def __init__(self, path: Path, layout: TextLayout) -> None:
        self._path, self._layout = path, layout
        self._encoding = _encoding_of(path)
        self.notes: tuple[Text, ...] = ()
        """What a reader should know of how it was read."""
        if self._encoding == _WINDOWS:
            self.notes = (Text(NoticeCode.READ_AS_WINDOWS_1252),)
        given = ""
        with path.open(encoding=self._encoding, newline="") as file:
            lines = _Lines(file, layout)
            heading = next((line for line in lines if line.strip()), "")
            if (excel := _EXCEL.fullmatch(heading)) is not None:
                given, heading = excel[1], next(lines, "")
            self._begin = lines.number
        found = max(_SEPARATORS, key=heading.count)
        self._separator = given or (found if found in heading or " " not in heading.strip() else " ")
        try:
            head = next(self._reader([heading]), [])
        except csv.Error as error:
            raise RecordingError(path, [Problem(f"line {self._begin}", _unreadable(error))]) from None
        self.head = [name.strip() for name in head]
        self._open_end = len(self.head) > 2 and not self.head[-1]
        """Whether every line ends with a separator."""
        if self._open_end:
            self.head.pop()
        if not any(self.head):
            raise RecordingError(path, [Problem("", "is empty; expected a heading and lines below it")])

    def advice(self) -> str:
        """Which lines seem not to belong to the table; empty if none do."""
        with self._path.open(encoding=self._encoding, newline="") as file:
            return advice_on(file, self._layout)

    def chunks(self, time: str, names: Sequence[str], problems: FileProblems) -> Iterator[Chunk]:
        """All rows of the time's column and of others."""
        wanted = [self.head.index(name) for name in (time, *names)]
        comma, marks = self._separator in _DECIMAL_COMMA, _Marks()
        places: list[int] = []
        rows: list[list[str]] = []
        repeated: list[int] = []
        for line, row in self._rows(problems):
            if self._open_end and len(row) == len(self.head) + 1 and not row[-1].strip():
                row.pop()
            if [cell.strip() for cell in row] == self.head:
                repeated.append(line)
                continue
            if len(row) != len(self.head):
                short = f"{len(row)} cells; the heading has {len(self.head)}"
                problems.add(f"line {line}", f"{short}; --skip {line} leaves the line out", "cells")
                continue
            cells = [row[i].strip() for i in wanted]
            if comma:
                marks.look(line, names, cells[1:])
                cells = [
                    _plain_time(cells[0]),
                    *(cell if "." in cell else cell.replace(",", ".") for cell in cells[1:]),
                ]
            rows.append(cells)
            places.append(line)
            if len(rows) == CHUNK_ROWS:
                yield _chunk(places, rows)
                places, rows = [], []
        if rows:
            yield _chunk(places, rows)
        marks.judge(problems)
        if repeated:
            skipped = ranges_text((*self._layout.skip, *((line, line) for line in repeated)))
            more = len(repeated) - 1
            what, them = ("repeats the heading", "it") if not more else (f"and {more} more repeat the heading", "them")
            problems.add(f"line {repeated[0]}", f"{what}; --skip {skipped} leaves {them} out")

    def _reader(self, lines: Iterable[str]) -> Iterator[list[str]]:
        """Splits lines into cells."""
        return csv.reader(lines, delimiter=self._separator, skipinitialspace=self._separator == " ", strict=True)

    def _rows(self, problems: FileProblems) -> Iterator[tuple[int, list[str]]]:
        """Line on which each row begins, and its cells; empty lines are skipped."""
        with self._path.open(encoding=self._encoding, newline="") as file:
            lines = _Lines(file, self._layout)
            while lines.number < self._begin:
                next(lines)
            spaced = (line.rstrip() for line in lines) if self._separator == " " else lines
            reader = self._reader(spaced)
            while True:
                lines.first = 0
                try:
                    row = next(reader, None)
                except csv.Error as error:  # the cells after it cannot be separated
                    problems.add(f"line {lines.first}", _unreadable(error))
                    return
                if row is None:
                    return
                if lines.number > lines.first and len(row) != len(self.head):
                    problems.add(f"line {lines.first}", _unreadable(f"it ends on line {lines.number}"))
                    return
                if any(cell and not cell.isspace() for cell in row):
                    yield lines.first, row


class _Lines:
    """The lines of a file, but those that are left out, with their numbers."""

    def __init__(self, file: Iterator[str], layout: TextLayout) -> None:
        self._file, self._layout = file, layout
        self.number = 0
        self.first = 0
        """Number of the first line since this was last set to 0."""

    def __iter__(self) -> "_Lines":
        return self

    def __next__(self) -> str:
        while True:
            line = next(self._file)
            self.number += 1
            if not self._layout.skips(self.number):
                self.first = self.first or self.number
                return line


class _Marks:
    """Tells 3.000 from three thousand: a file that has both decimal commas and points leaves it open."""

    def __init__(self) -> None:
        self._decimal: dict[str, str] = {}
        """A cell with each mark that can be nothing but a decimal one."""
        self._open: dict[str, tuple[int, str, str]] = {}
        """Line, column and cell in which each mark may separate thousands."""

    def look(self, line: int, names: Sequence[str], cells: Sequence[str]) -> None:
        for name, cell in zip(names, cells, strict=True):
            mark = "," if "," in cell else "." if "." in cell else ""
            if not mark or (mark in self._decimal and mark in self._open):
                continue
            if _THOUSANDS.fullmatch(cell):
                self._open.setdefault(mark, (line, name, cell))
            else:
                self._decimal.setdefault(mark, cell)

    def judge(self, problems: FileProblems) -> None:
        for mark, other in ((".", ","), (",", ".")):
            if mark in self._open and mark not in self._decimal and other in self._decimal:
                line, name, cell = self._open[mark]
                what = f"{cell!r} may be a number with thousands separated, because elsewhere the decimal mark is "
                what += f"{other!r} ({self._decimal[other]!r}); write such numbers without a mark for thousands"
                problems.add(f"line {line}, column {name!r}", what)


def _plain_time(cell: str) -> str:
    """With a point in a plain number; a comma in a date stays as it was written."""
    number = cell.replace(",", ".")
    try:
        float(number)
    except ValueError:
        return cell
    return number


def _chunk(places: list[int], rows: list[list[str]]) -> Chunk:
    time, *columns = zip(*rows, strict=True)
    return Chunk(places, time, columns)


def _unreadable(why: object) -> str:
    return f'cannot be split into cells: is a quote (") opened but not closed? ({why})'


def _encoding_of(path: Path) -> str:
    """UTF-8, UTF-16 by its mark, or Windows-1252. RecordingError: the line of the first byte that is none of them."""
    with path.open("rb") as file:
        begin = file.read(4)
    marked = next((encoding for mark, encoding in _MARKS if begin.startswith(mark)), None)
    if marked is not None:
        try:
            with path.open(encoding=marked) as text:
                while text.read(1 << 20):
                    pass
        except UnicodeError as error:
            raise RecordingError(path, [Problem("", f"is not valid {marked.upper()}: {error}")]) from None
        return marked
    if begin in _BOOKS:
        what = "is a workbook of a spreadsheet; save the sheet as *CSV UTF-8*"
        raise RecordingError(path, [Problem("", what)])
    other: Problem | None = None
    windows = True
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                byte = f"byte {error.start + 1} of the line is {line[error.start]:#04x}"
                what = f"is neither Parquet nor UTF-8 text: {byte}; save the table as CSV UTF-8"
                other = other or Problem(f"line {number}", what)
            if other is not None or not line.isascii():
                windows = windows and _is_windows(line)
            if other is not None and not windows:
                raise RecordingError(path, [other])
    return "utf-8-sig" if other is None else _WINDOWS


def _is_windows(line: bytes) -> bool:
    """Whether a line may be text in Windows-1252: no byte that it leaves out, and none that text does not have."""
    try:
        line.decode(_WINDOWS)
    except UnicodeDecodeError:
        return False
    return not any(byte < 32 and byte not in b"\t\r\n\f" for byte in line)
