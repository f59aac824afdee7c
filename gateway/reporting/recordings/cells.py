"""Parses the cells of a recording that hold numbers, or says what is wrong with them."""

import math
from collections.abc import Callable, Sequence
from decimal import Decimal
from typing import TypeVar

import numpy as np

from gateway.config.problems import shown
from gateway.reporting.recordings.layout import Unknown
from gateway.reporting.recordings.problems import FileProblems
from talc.frame import FloatArray

Where = Callable[[int], str]
"""Place of a cell, for a person, by its position in the chunk."""

_Else = TypeVar("_Else")


def numbers_of(
    cells: Sequence[object], name: str, largest: float, where: Where, problems: FileProblems, unknown: Unknown
) -> FloatArray:
    """(rows,) NaN where a cell is empty or says that its value is unknown. largest: the largest magnitude allowed."""
    try:
        found = np.array([math.nan if cell in (None, "") else float(cell) for cell in cells])  # type: ignore[arg-type]
        found = unknown.without_numbers(found)
        plain = not any(isinstance(cell, str) and "_" in cell for cell in cells)
        if plain and not (np.abs(found) > largest).any():
            return found
    except (TypeError, ValueError, OverflowError):
        pass
    found = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        if unknown.is_word(cell):
            continue
        value = number_of(cell, default=math.inf)
        if unknown.is_number(value):
            continue
        if math.isinf(value):
            what = f"{shown(cell)} is not a finite number; leave an unknown value empty"
            if isinstance(cell, str):
                what += f", or --missing {cell!r} says that it is one; --ignore {name!r} leaves the column out"
            problems.add(where(i), what, f"number {name}")
        elif abs(value) > largest:
            what = f"{shown(cell)} is beyond {largest:g}, the largest allowed; leave an unknown value empty"
            problems.add(where(i), what, f"size {name}")
        else:
            found[i] = value
    return found


def number_of(cell: object, default: _Else) -> float | _Else:
    """The cell as a float; otherwise `default`. Python reads `2_0` as 20, but no table means that."""
    if isinstance(cell, str) and "_" in cell:
        return default
    if isinstance(cell, int | float | str | Decimal):
        try:
            return float(cell)
        except (ValueError, OverflowError):
            return default
    return default
