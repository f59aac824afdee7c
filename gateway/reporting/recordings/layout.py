"""The layout of a text file: which lines are not its table, and which words stand for an unknown value."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray

_UNKNOWN = frozenset({"", "nan", "na", "n/a", "#n/a", "#nv", "none", "null", "-", "--", "---", "?"})
"""What spreadsheets and loggers write where they know nothing; #NV is German for #N/A."""
_LINES = re.compile(r"(\d+)(?:\s*-\s*(\d+))?")


@dataclass(frozen=True, slots=True)
class TextLayout:
    """How a file differs from a heading with lines below it."""

    skip: tuple[tuple[int, int], ...] = ()
    """First and last of the lines that are left out, from 1."""
    missing: tuple[str, ...] = ()
    """Cells that stand for an unknown value, besides those that always do."""

    def skips(self, line: int) -> bool:
        """Whether a line is left out."""
        return any(first <= line <= last for first, last in self.skip)


def line_ranges(texts: Iterable[str]) -> tuple[tuple[int, int], ...]:
    """First and last of each range in `1-3,5`. Raises ValueError."""
    found = []
    for text in (part.strip() for given in texts for part in given.split(",")):
        match = _LINES.fullmatch(text)
        first, last = (0, 0) if match is None else (int(match[1]), int(match[2] or match[1]))
        if not 1 <= first <= last:
            raise ValueError(f"{text!r}: expected a line or lines, such as 1-3 or 5; the first is 1")
        found.append((first, last))
    return tuple(found)


def ranges_text(ranges: Iterable[tuple[int, int]]) -> str:
    """First and last of each range as `--skip` takes them."""
    return ",".join(f"{a}-{b}" if b > a else f"{a}" for a, b in ranges)


class Unknown:
    """Recognises cells without a value."""

    def __init__(self, missing: Iterable[str] = ()) -> None:
        given = {word.strip().lower() for word in missing}
        self._words = _UNKNOWN | given
        self._numbers = [number for word in given if (number := _number_in(word)) is not None]

    def is_word(self, cell: object) -> bool:
        """Whether a cell says that its value is unknown."""
        return cell is None or (isinstance(cell, str) and cell.strip().lower() in self._words)

    def is_number(self, value: float) -> bool:
        """Whether a number stands for an unknown value, or is NaN."""
        return math.isnan(value) or value in self._numbers

    def without_numbers(self, values: FloatArray) -> FloatArray:
        """The same array, with NaN where a number stands for an unknown value."""
        if self._numbers:
            values[np.isin(values, self._numbers)] = np.nan
        return values


def _number_in(word: str) -> float | None:
    try:
        return float(word.replace(",", "."))
    except ValueError:
        return None
