"""The tables of a database as people read them: one value a column, with names and units; to CSV or Parquet."""

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from itertools import islice
from pathlib import Path

from gateway.runtime.extras import need_extra
from gateway.storage import columns
from gateway.storage.configurations import stored_config
from gateway.storage.history import History

NamedRows = tuple[columns.CellKinds, Iterator[columns.Cells]]

_AT_ONCE = 10_000


def _steps(history: History) -> NamedRows:
    config = stored_config(history)
    found = history.steps(names=config.input_names)
    return columns.steps(config.input_names), (columns.step_cells(step, config.grid.step_s) for step in found)


_TABLES: Mapping[str, Callable[[History], NamedRows]] = {
    "readings": lambda h: (columns.READINGS, ((columns.utc(row[0]), *row[1:]) for row in h.readings())),
    "minutes": lambda h: (columns.MINUTES, ((columns.utc(row[0]), *row[1:]) for row in h.minutes())),
    "steps": _steps,
    "measurements": lambda h: (columns.MEASUREMENTS, map(columns.measurement_cells, h.measurements())),
    "events": lambda h: (columns.EVENTS, map(columns.event_cells, h.events())),
    "compensation": lambda h: (columns.COMPENSATION_CELLS, map(columns.compensation_cells, h.compensation())),
    "commands": lambda h: (columns.COMMANDS, map(columns.command_cells, h.commands())),
    "runs": lambda h: (columns.RUNS, map(columns.run_cells, h.starts())),
}


def export_table(database: Path, table: str, output: Path) -> int:
    """Write a table to a .csv or .parquet file, which appears when it is whole. Returns the number of rows."""
    part = output.with_name(output.name + ".part")
    write = _write_parquet if output.suffix == ".parquet" else _write_csv
    try:
        with History(database) as history:
            many = write(part, *_TABLES[table](history))
        part.replace(output)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return many


def _write_csv(path: Path, names: columns.CellKinds, rows: Iterator[columns.Cells]) -> int:
    many = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(names)
        for row in rows:
            out.writerow([_csv(value) for value in row])
            many += 1
    return many


def _csv(value: object) -> object:
    if isinstance(value, datetime):
        return value.isoformat()
    return None if isinstance(value, float) and math.isnan(value) else value


def _write_parquet(path: Path, names: columns.CellKinds, rows: Iterator[columns.Cells]) -> int:
    need_extra("parquet")
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {"time": pa.timestamp("us", tz="UTC"), "text": pa.string(), "number": pa.float64(), "whole": pa.int64()}
    schema, many = pa.schema([(name, kinds[kind]) for name, kind in names.items()]), 0
    with parquet.ParquetWriter(path, schema) as out:
        while some := list(islice(rows, _AT_ONCE)):
            values = zip(*some, strict=True)
            out.write_table(
                pa.table(
                    [pa.array(v, t.type, from_pandas=True) for v, t in zip(values, schema, strict=True)], schema=schema
                )
            )
            many += len(some)
    return many
