"""Finds where the table of a logger's file seems to begin: below a block of settings, and above a row of units."""

import csv
from collections.abc import Iterable
from itertools import islice

from gateway.reporting.recordings.layout import TextLayout, ranges_text

_LOOKED_AT = 200
"""Lines."""
_ALIKE = 3
"""Lines of data that follow each other."""
_SHOWN = 3
"""Names of columns that are quoted."""


def advice_on(lines: Iterable[str], layout: TextLayout) -> str:
    """The option `--skip` that leaves out what is above the heading and between it and the first numbers; or nothing.

    lines: the file's, from its first one.
    """
    seen = [(number, line.rstrip("\r\n")) for number, line in enumerate(islice(lines, _LOOKED_AT), 1)]
    left = [(number, line) for number, line in seen if line.strip() and not layout.skips(number)]
    for separator in (";", "\t", ",", " "):
        rows = [(number, _cells(line, separator)) for number, line in left]
        first = next((at for at in range(len(rows) - _ALIKE + 1) if _data(rows[at : at + _ALIKE])), None)
        if first is None:
            continue
        width = len(rows[first][1])
        top = first
        while top and _wide(rows[top - 1][1], width) and not _numbers(rows[top - 1][1]):
            top -= 1
        if top == first:
            return f"line {rows[first][0]} holds numbers, and no line above it has as many names: is there a heading?"
        heading, names = rows[top]
        skipped = list(layout.skip)
        if top:
            skipped.append((1, heading - 1))
        if first > top + 1:
            skipped.append((heading + 1, rows[first][0] - 1))
        if len(skipped) == len(layout.skip):
            return ""
        shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
        return f"the table seems to begin on line {heading} ({shown}): --skip {ranges_text(sorted(skipped))}"
    return ""


def _cells(line: str, separator: str) -> list[str]:
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=separator == " "), [])
    except csv.Error:  # a cell of more than 131,072 characters: not of a table's first lines
        return []
    return [cell.strip() for cell in cells]


def _wide(cells: list[str], width: int) -> bool:
    """Whether a line has a cell for each column; the last ones may be empty in a line of data."""
    return len(cells) == width and sum(map(bool, cells)) > 1


def _data(rows: list[tuple[int, list[str]]]) -> bool:
    """Whether these are lines of a table: as many cells each, most of them numbers."""
    width = len(rows[0][1])
    return width > 1 and all(len(cells) == width and _numbers(cells) for _, cells in rows)


def _numbers(cells: list[str]) -> bool:
    """Whether at least half of the cells with anything in them are numbers, and more than one cell has."""
    filled = [cell for cell in cells if cell]
    return len(filled) > 1 and 2 * sum(map(_is_number, filled)) >= len(filled)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
