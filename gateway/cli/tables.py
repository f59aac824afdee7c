"""The tables of a database as people read them: one value a column, with names and units; to CSV or Parquet."""

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Literal

import click

from gateway.past import stored_config
from gateway.storage import History
from talc.names import ERROR_UNITS, THERMAL_ERRORS

Kind = Literal["time", "text", "number", "whole"]
Columns = Mapping[str, Kind]
"""Name to kind, in order. Times are UTC; a number that is not known is empty."""
Cells = Sequence[object]

_AT_ONCE = 10_000
_UNITS = {name: unit.replace("µ", "u").replace("/", "_per_") for name, unit in ERROR_UNITS.items()}


def _nine(prefix: str) -> dict[str, Kind]:
    return {f"{prefix}_{name}_{_UNITS[name]}": "number" for name in THERMAL_ERRORS}


def _readings(history: History) -> tuple[Columns, Iterator[Cells]]:
    columns: Columns = {
        "time": "time", "channel": "text", "value": "number", "unit": "text", "quality": "text", "detail": "text",
        "run": "whole", "sequence": "whole",
    }  # fmt: skip
    return columns, ((_utc(row[0]), *row[1:]) for row in history.readings())


def _minutes(history: History) -> tuple[Columns, Iterator[Cells]]:
    columns: Columns = {
        "time": "time", "channel": "text", "unit": "text", "count": "whole", "mean": "number", "low": "number",
        "high": "number",
    }  # fmt: skip
    return columns, ((_utc(row[0]), *row[1:]) for row in history.minutes())


def _steps(history: History) -> tuple[Columns, Iterator[Cells]]:
    config = stored_config(history)
    inputs: dict[str, Kind] = {f"input_{name}": "number" for name in config.input_names}
    decided = {**_nine("predicted"), **_nine("corrected"), **_nine("sigma"), **_nine("limit")}
    columns: Columns = {
        "k": "whole", "time": "time", "phase": "text", **inputs, **_nine("measured"), **decided,
        **{f"trusted_{name}": "whole" for name in THERMAL_ERRORS}, "measurement_wanted": "text",
    }  # fmt: skip

    def rows() -> Iterator[Cells]:
        for step in history.steps(names=config.input_names):
            frame, decision = step.frame, step.decision
            values = [x if ok else None for x, ok in zip(frame.inputs.tolist(), frame.valid.tolist(), strict=True)]
            measured = [None] * len(THERMAL_ERRORS) if frame.measurement is None else frame.measurement.errors.tolist()
            made = (decision.predicted, decision.corrected, decision.sigma, decision.limits)
            yield (
                frame.k, _utc(frame.k * config.grid.step_s), decision.phase.value, *values, *measured,
                *(x for array in made for x in array.tolist()), *map(int, decision.trusted.tolist()),
                None if decision.measure is None else decision.measure.value,
            )  # fmt: skip

    return columns, rows()


def _measurements(history: History) -> tuple[Columns, Iterator[Cells]]:
    columns: Columns = {
        "number": "whole",
        "ended": "time",
        "why": "text",
        **_nine("measured"),
        "rejected_because": "text",
    }
    none = [None] * len(THERMAL_ERRORS)
    return columns, (
        (m.number, m.ended, m.why, *(none if m.errors is None else m.errors.tolist()), m.reason)
        for m in history.measurements()
    )


def _events(history: History) -> tuple[Columns, Iterator[Cells]]:
    columns: Columns = {
        "time": "time", "k": "whole", "kind": "text", "text": "text", "error": "text", "value": "number",
        "limit": "number",
    }  # fmt: skip
    return columns, ((at, k, e.kind.value, e.text, e.error, e.value, e.limit) for at, k, e in history.events())


def _compensation(history: History) -> tuple[Columns, Iterator[Cells]]:
    columns: Columns = {
        "time": "time", "mode": "text", "source": "text", "x_um": "number", "y_um": "number", "z_um": "number",
        "written": "whole",
    }  # fmt: skip
    return columns, ((c.time, c.mode, c.source, *c.offsets_um.tolist(), int(c.written)) for c in history.compensation())


TABLES: Mapping[str, Callable[[History], tuple[Columns, Iterator[Cells]]]] = {
    "readings": _readings,
    "minutes": _minutes,
    "steps": _steps,
    "measurements": _measurements,
    "events": _events,
    "compensation": _compensation,
}


def export(database: Path, table: str, output: Path) -> int:
    """Write a table to a .csv or .parquet file, which appears when it is whole. Returns the number of rows."""
    part = output.with_name(output.name + ".part")
    write = _write_parquet if output.suffix == ".parquet" else _write_csv
    try:
        with History(database) as history:
            many = write(part, *TABLES[table](history))
        part.replace(output)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return many


def _write_csv(path: Path, columns: Columns, rows: Iterator[Cells]) -> int:
    many = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(columns)
        for row in rows:
            out.writerow([_csv(value) for value in row])
            many += 1
    return many


def _csv(value: object) -> object:
    if isinstance(value, datetime):
        return value.isoformat()
    return None if isinstance(value, float) and math.isnan(value) else value


def _write_parquet(path: Path, columns: Columns, rows: Iterator[Cells]) -> int:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise click.UsageError("Parquet needs pyarrow: pip install 'talc-gateway[parquet]'; or export CSV") from None
    kinds = {"time": pa.timestamp("us", tz="UTC"), "text": pa.string(), "number": pa.float64(), "whole": pa.int64()}
    schema, many = pa.schema([(name, kinds[kind]) for name, kind in columns.items()]), 0
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


def _utc(timestamp: float) -> datetime:
    return datetime.fromtimestamp(timestamp, UTC)
