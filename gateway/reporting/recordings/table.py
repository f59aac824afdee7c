"""Writes a table of columns as CSV or Parquet, by the file's suffix."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from gateway.config.problems import Problem
from gateway.reporting.recordings.problems import RecordingError


def write_table(path: Path, columns: Mapping[str, Sequence[object]]) -> None:
    """The columns, of equal length; a number that is NaN is an empty cell. Raises RecordingError and OSError.

    path: Parquet if it ends in `.parquet`, otherwise CSV.
    """
    if path.suffix == ".parquet":
        try:
            from pyarrow import array, float64, parquet, table
        except ImportError:
            what = "Parquet needs pyarrow: install talc-gateway with the extra `parquet`, or write .csv"
            raise RecordingError(path, [Problem("", what)]) from None
        # A column of nothing but NaN would have no type.
        arrays = {
            name: array(map(_known, cells), float64() if any(isinstance(cell, float) for cell in cells) else None)
            for name, cells in columns.items()
        }
        parquet.write_table(table(arrays), path)
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if (cell := _known(value)) is None else cell for value in row])


def _known(cell: object) -> object:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
