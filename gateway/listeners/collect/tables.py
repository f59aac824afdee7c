"""Converts the rows that gateways send to Arrow tables by day."""

import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

import pyarrow as pa
from pyarrow import compute

from gateway.storage.epochs import BEFORE_ALL
from gateway.telemetry.answers import StoredColumn, StoredTable

_TYPES = {"time": pa.timestamp("us", tz="UTC"), "text": pa.string(), "number": pa.float64(), "whole": pa.int64()}

_EPOCH = re.compile(r"[0-9a-f]{32}")
_LARGEST = 2**63 - 1
_LATEST_S = 7258118400.0
"""2200."""
_OURS = ("epoch", "row", "machine", "day")
"""Columns that are added, or that a reader of the folder gets from the names of folders."""


def arrow_of(table: StoredTable, above: int | None) -> pa.Table:
    """The rows with their epoch and number, without those that are there already.

    above: number of the last row of this epoch that is there; None: there is none

    Raises ValueError for rows that contradict themselves: another program's, or damaged on the way.
    """
    _check_place(table)
    ascending = all(a < b for a, b in pairwise(table.numbers))
    if table.numbers and not (ascending and table.numbers[-1] <= table.last):
        raise ValueError(f"rows {table.numbers[0]} to {table.numbers[-1]} do not ascend up to {table.last}")
    arrays, names = [], []
    for column in table.columns:
        if len(column.values) != len(table.numbers):
            raise ValueError(f"column {column.name}: {len(column.values)} values for {len(table.numbers)} rows")
        arrays.append(_array(column))
        names.append(column.name)
    numbers = pa.array(table.numbers, pa.int64())
    rows = pa.table([*arrays, pa.repeat(table.epoch, len(numbers)), numbers], [*names, "epoch", "row"])
    return rows if above is None else rows.slice(bisect_right(table.numbers, above))


def check_end(table: StoredTable, asked: int | None) -> None:
    """Raises ValueError for a page that says that it goes further than its rows do: they would never be asked for.

    Only of an epoch that is over the page may say so: then there is more, of another epoch.

    asked: number of the row that the asker has; None: it has none
    """
    end = table.numbers[-1] if table.numbers else asked if asked is not None else BEFORE_ALL
    if not table.more and table.last > end:
        raise ValueError(f"rows end at {end}, but the page says that it goes up to {table.last}")


def _check_place(table: StoredTable) -> None:
    """Raises ValueError for what no gateway says: it would be asked for again without end, or be in no file."""
    if table.epoch is not None and not _EPOCH.fullmatch(table.epoch):
        raise ValueError(f"epoch {table.epoch[:40]!r}: expected 32 hexadecimal digits")
    for number in (*table.numbers[:1], *table.numbers[-1:], table.last, table.thinned or 0):
        if abs(number) > _LARGEST:
            raise ValueError(f"row {number}: no row has such a number")
    names = Counter([*(column.name for column in table.columns), *_OURS])
    for name, many in names.items():
        if many > 1:
            raise ValueError(f"column {name}: occurs twice, or has a name that the collector itself uses")


def by_day(rows: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Each day, UTC, and its rows in their order. Raises ValueError for rows without a time."""
    days = compute.strftime(rows[time_column(rows)], format="%Y-%m-%d")
    for day in compute.unique(days).to_pylist():
        yield day, rows.filter(compute.equal(days, day))


def time_column(rows: pa.Table) -> str:
    """The column with the time of each row. Raises ValueError for rows without a time."""
    times: list[str] = [name for name in rows.column_names if pa.types.is_timestamp(rows.schema.field(name).type)]
    if not times or rows[times[0]].null_count:
        raise ValueError("rows without a time")
    return times[0]


def _array(column: StoredColumn) -> pa.Array:
    kind = _TYPES.get(column.kind)
    if kind is None:
        raise ValueError(f"column {column.name}: kind {column.kind!r} is not known; use a newer program")
    try:
        match column.kind:
            case "text":
                places = pa.array(column.values).cast(pa.int32())  # refuses fractions
                return pa.DictionaryArray.from_arrays(places, pa.array(column.texts, pa.string())).cast(pa.string())
            case "time":
                seconds = pa.array(column.values, pa.float64(), from_pandas=True)
                bounds = compute.min_max(seconds)
                for time_s in (bounds["min"].as_py(), bounds["max"].as_py()):
                    if time_s is not None and not 0.0 <= time_s <= _LATEST_S:
                        raise ValueError(f"column {column.name}: {time_s:g} s is not within the years 1970 to 2200")
                return compute.round(compute.multiply(seconds, 1e6)).cast(pa.int64()).cast(kind)
            case "number":
                return pa.array(column.values, kind)
            case _:
                return pa.array(column.values).cast(kind)  # refuses fractions
    except (pa.ArrowException, TypeError, OverflowError) as error:
        raise ValueError(f"column {column.name}: {error}") from error
