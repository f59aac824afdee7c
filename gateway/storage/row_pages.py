"""The rows of a database after a position, table by table, for collectors: only committed rows, each once.

Nothing is deleted because someone has it: rows stay as long as [storage] says. Where rows are gone before they were
asked for, the page says so.
"""

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.config.outline import inputs_if_known, step_s_of
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.storage import columns, rows
from gateway.storage.columns import CellKinds, Cells
from gateway.storage.epochs import NUMBERS, Position, RowSpan, next_span
from gateway.storage.faults import StoreError
from gateway.storage.readings import QUALITIES, READ_ROWS, upto_thinned
from gateway.storage.schema import SCHEMA_VERSION, UNREADABLE, unusable
from gateway.storage.stored import StoredStep

_LAST = 2**63 - 1
_MOST: Final[Mapping[str, int]] = {
    "measurements": 1000, "steps": 1000, "models": 10, "events": 2000, "compensation": 5000, "minutes": 10_000,
    "readings": 50_000, "commands": 2000, "runs": 100,
    "reasons": 200,
}  # fmt: skip
"""Rows of one page, so that the pages of all tables have a few MB together."""


class TableRows(NamedTuple):
    """What was found of a table. Times are datetimes, or seconds since 1970."""

    columns: CellKinds
    rows: Sequence[tuple[int, Cells]]
    """Number and cells."""
    cut: bool = False
    """Whether rows with other columns follow."""


@dataclass(frozen=True, slots=True)
class RowsPage:
    """Rows of one table after a position."""

    epoch: str | None
    """Epoch of these rows; None: this database does not know the position's epoch, and the page is empty."""
    columns: CellKinds
    numbers: list[int]
    """Numbers of the rows, ascending."""
    rows: list[Cells]
    thinned: int | None
    """Rows up to this number were deleted before they were asked for, as they were old; None: none were."""
    last: int
    """Where the next page begins, in this epoch."""
    more: bool
    """Whether there are more rows now."""


def rows_after(path: Path, after: Mapping[str, Position | None], limit: int) -> dict[str, RowsPage | StoreError]:
    """The next page of each of these tables, of one moment; a table that cannot be read gives its error.

    after: by table; None: from the beginning
    limit: rows of a table, at least 1

    Raises ValueError naming a table that does not exist, StoreError if the database cannot be read at all.
    """
    for table in after:
        if table not in NUMBERS:
            raise ValueError(Text(NoticeCode.NO_SUCH_TABLE, table=table, tables=tuple(NUMBERS)))
    if not path.is_file():
        raise StoreError(f"{path}: no such file")
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)) as connection:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version != SCHEMA_VERSION:
                raise StoreError(f"{path}: schema version {version}, expected {SCHEMA_VERSION}")
            connection.execute("BEGIN")
            return {table: _page_or_error(path, connection, table, after[table], limit) for table in after}
    except UNREADABLE as error:
        raise unusable(path, error) from error


def _page_or_error(
    path: Path, connection: sqlite3.Connection, table: str, position: Position | None, limit: int
) -> RowsPage | StoreError:
    try:
        return _page(connection, table, position, min(limit, _MOST[table]))
    except (*UNREADABLE, ValueError, OverflowError, StoreError) as error:
        return StoreError(f"{path}: {table} cannot be read: {error}")


def _page(connection: sqlite3.Connection, table: str, position: Position | None, limit: int) -> RowsPage:
    span = next_span(connection, table, position)
    if span is None:
        return RowsPage(None, {}, [], [], None, 0, more=False)
    gone = upto_thinned(connection, table)
    found = _TABLES[table](connection, span, limit + 1)
    kept = found.rows[:limit]
    cut = found.cut or len(found.rows) > limit
    last = kept[-1][0] if kept else span.above
    if span.upto is not None and not cut:
        last = span.upto  # the epoch is over
    return RowsPage(
        span.epoch,
        found.columns,
        [number for number, _ in kept],
        [cells for _, cells in kept],
        gone if gone is not None and span.above < gone else None,
        last,
        more=cut or span.upto is not None,
    )


def _select(connection: sqlite3.Connection, query: str, number: str, span: RowSpan, limit: int) -> list[Any]:
    """Rows of the span; the query's first column is their number."""
    upto = _LAST if span.upto is None else span.upto
    where = f"{query} WHERE {number} > ? AND {number} <= ? ORDER BY {number} LIMIT ?"
    return connection.execute(where, (span.above, upto, limit)).fetchall()


def _readings(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
    words = [quality.value for quality in QUALITIES]
    found = _select(connection, READ_ROWS, "r.id", span, limit)
    return TableRows(
        columns.READINGS,
        [
            (number, (*cells, words[quality], detail or "", run, sequence))
            for number, *cells, quality, detail, run, sequence in found
        ],
    )


def _minutes(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
    query = (
        "SELECT m.id, m.time, c.name, c.unit, m.count, m.mean, m.low, m.high FROM minute m"
        " JOIN channel c ON c.id = m.channel"
    )
    found = _select(connection, query, "m.id", span, limit)
    return TableRows(columns.MINUTES, [(number, cells) for number, *cells in found])


def _steps(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
    """As long as they have the same inputs."""
    query = (
        f"SELECT f.k, {rows.STEP_COLUMNS}, t.trusted, p.k, coalesce(b.config, '') FROM frame f"
        " JOIN decision d ON d.k = f.k LEFT JOIN trust t ON t.k = f.k LEFT JOIN pause p ON p.k = f.k"
        " LEFT JOIN boot b ON b.id = f.boot"
    )
    found = _select(connection, query, "f.k", span, limit)
    if not found:
        return TableRows(columns.steps(()), [])
    step_s = _step_s(connection)
    names_of = {config: inputs_if_known(config) for config in {row[-1] for row in found}}
    first = found[0]
    size = len(rows.step_of(first[1:-2], ()).frame.inputs)
    names = names_of[first[-1]]
    if len(names) != size:  # the run's configuration is lost
        names = tuple(str(number) for number in range(size))
    alike = list(takewhile(lambda row: names_of[row[-1]] == names_of[first[-1]], found))
    cells = [(row[0], columns.step_cells(_step_of(row[1:-2], row[-2] is not None), step_s)) for row in alike]
    return TableRows(columns.steps(names), cells, cut=len(alike) < len(found))


def _step_of(row: Sequence[Any], pause_unknown: bool) -> StoredStep:
    step = rows.step_of(row, ())
    return replace(step, frame=replace(step.frame, pause_unknown=pause_unknown))


def _models(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
    found = _select(connection, "SELECT id, after_k, fingerprint, models FROM model", "id", span, limit)
    step_s = _step_s(connection)
    cells = [(number, (after_k * step_s, after_k, *texts)) for number, after_k, *texts in found]
    return TableRows(columns.MODEL_CELLS, cells)


_TablePage = Callable[[sqlite3.Connection, RowSpan, int], TableRows]


def _each(
    table: str, selected: str, kinds: CellKinds, cells: Callable[[Sequence[Any]], Cells], number: str = "id"
) -> _TablePage:
    """The rows of a table whose rows are independent. cells: of the selected columns; number: the row's column."""

    def page(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
        found = _select(connection, f"SELECT {number}, {selected} FROM {table}", number, span, limit)
        return TableRows(kinds, [(of_row, cells(row)) for of_row, *row in found])

    return page


def _events(connection: sqlite3.Connection, span: RowSpan, limit: int) -> TableRows:
    coded = connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'coded'").fetchone()
    selected = f"{rows.EVENT_COLUMNS}, {rows.CODE_OF_EVENT if coded else 'NULL, NULL'}"
    page = _each("event", selected, columns.EVENTS, lambda row: columns.event_cells(rows.coded_event_of(row)))
    return page(connection, span, limit)


_TABLES: Final[Mapping[str, _TablePage]] = {
    "measurements": _each(
        "measurement",
        rows.MEASUREMENT_COLUMNS,
        columns.MEASUREMENTS,
        lambda row: columns.measurement_cells(rows.measurement_of(row)),
    ),
    "steps": _steps,
    "models": _models,
    "events": _events,
    "compensation": _each(
        "compensation",
        rows.COMPENSATION_COLUMNS,
        columns.COMPENSATION_CELLS,
        lambda row: columns.compensation_cells(rows.compensation_of(row)),
    ),
    "minutes": _minutes,
    "readings": _readings,
    "commands": _each(
        "command", rows.COMMAND_COLUMNS, columns.COMMANDS, lambda row: columns.command_cells(rows.command_of(row))
    ),
    "reasons": _each(
        "reasons",
        "time, reasons",
        columns.REASON_CELLS,
        lambda row: columns.reasons_cells(columns.utc(row[0]), rows.reasons_of(row[1])),
        "k",
    ),
    "runs": _each("boot", rows.RUN_COLUMNS, columns.RUNS, lambda row: columns.run_cells(rows.run_of(row)), "number"),
}


def _step_s(connection: sqlite3.Connection) -> float:
    """The grid step, which is the same for all runs of a database."""
    found = connection.execute("SELECT config FROM boot ORDER BY number DESC LIMIT 1").fetchone()
    return step_s_of("" if found is None else found[0])
