"""Answers queries on `history`, `course` and `stored` from the database, opened for reading at each query."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from gateway.model.text import text_of
from gateway.storage.block_pages import BlocksPage, blocks_page
from gateway.storage.columns import CellKind
from gateway.storage.course_pages import StoredReasons, course_between
from gateway.storage.epochs import Position
from gateway.storage.faults import StoreError
from gateway.storage.mean_pages import means_page
from gateway.storage.pages import readings_page
from gateway.storage.readings import QUALITIES
from gateway.storage.row_pages import RowsPage, rows_after
from gateway.telemetry.answers import (
    CoursePage,
    HistoryBlock,
    HistoryPage,
    StoredColumn,
    StoredReason,
    StoredRows,
    StoredTable,
)
from gateway.telemetry.compose import reason_of_each
from gateway.telemetry.history_queries import CourseRequest, CourseSource, HistoryRequest, HistorySource
from gateway.telemetry.numbers import by_error, columns_by_error, courses, finite
from gateway.telemetry.stored_queries import StoredRequest, StoredSource
from talc.frame import FloatArray


def history_of(path: Path) -> HistorySource:
    """Pages of readings of a database."""

    def find(asked: HistoryRequest) -> HistoryPage:
        try:
            wanted = path, asked.begin, asked.end, asked.channels, asked.limit
            if asked.blocks:
                return _in_blocks(blocks_page(*wanted, asked.after))
            page = (
                readings_page(*wanted, asked.after)
                if asked.every_s is None
                else means_page(*wanted, asked.every_s, asked.after)
            )
        except StoreError as error:
            raise OSError(text_of(error)) from error
        return HistoryPage(
            page.period_s, page.names, page.units, page.time, page.channel, page.value, page.quality, page.next
        )

    return find


def _in_blocks(page: BlocksPage) -> HistoryPage:
    return HistoryPage(
        page.period_s, page.names, page.units, [], [], [], [], page.next,
        tuple(HistoryBlock(*block) for block in page.blocks), page.numbers, tuple(q.value for q in QUALITIES),
    )  # fmt: skip


def course_of(path: Path, step_s: float) -> CourseSource:
    """Estimates and measurements of a database."""

    def find(asked: CourseRequest) -> CoursePage:
        try:
            wanted = path, asked.begin, asked.end, asked.limit, step_s
            found = course_between(*wanted, temperatures=asked.temperatures, reasons=asked.reasons, inputs=asked.inputs)
        except StoreError as error:
            raise OSError(text_of(error)) from error
        return CoursePage(
            found.time.tolist(),
            courses(found.corrected, found.sigma),
            found.measured_time.tolist(),
            courses(found.measured, found.measured_sigma),
            [finite(value) for value in found.residual_um.tolist()],
            _by_name(found.temperature_names, found.temperatures),
            [_reason(each) for each in found.reasons],
            columns_by_error(found.left),
            _by_name(found.other_names, found.others),
            list(found.marked),
        )

    return find


def _by_name(names: Sequence[str], values: FloatArray) -> dict[str, list[float | None]]:
    """The columns of (n, t) numbers, to a hundredth."""
    columns = np.round(values, 2).T.tolist()
    return {name: [finite(v) for v in column] for name, column in zip(names, columns, strict=True)}


def _reason(given: StoredReasons) -> StoredReason:
    return StoredReason(
        datetime.fromtimestamp(given.time, UTC).isoformat(),
        given.reasons.k,
        reason_of_each(given.reasons),
        by_error(given.sigma),
        None if given.measured is None else given.measured.isoformat(),
    )


def rows_of(path: Path) -> StoredSource:
    """Rows of a database after a position."""

    def find(asked: StoredRequest) -> StoredRows:
        after = {table: None if position is None else Position(*position) for table, position in asked.after.items()}
        try:
            found = rows_after(path, after, asked.limit)
        except StoreError as error:
            raise OSError(text_of(error)) from error
        return StoredRows({table: _table(page) for table, page in found.items()})

    return find


def _table(page: RowsPage | StoreError) -> StoredTable:
    if isinstance(page, StoreError):
        return StoredTable(problem=str(page))
    by_column = zip(*page.rows, strict=True) if page.rows else ((),) * len(page.columns)
    columns = (
        _column(name, kind, values) for (name, kind), values in zip(page.columns.items(), by_column, strict=True)
    )
    return StoredTable(page.epoch, page.last, page.more, page.thinned, page.numbers, tuple(columns))


def _column(name: str, kind: CellKind, values: tuple[object, ...]) -> StoredColumn:
    match kind:
        case "text":
            place = {text: at for at, text in enumerate(dict.fromkeys(v for v in values if v is not None))}
            at = [None if value is None else place[value] for value in values]
            return StoredColumn(name, kind, at, tuple(map(str, place)))
        case "time":
            return StoredColumn(
                name, kind, [v.timestamp() if isinstance(v, datetime) else _cell_number(v) for v in values]
            )
        case "whole":
            return StoredColumn(name, kind, [v if isinstance(v, int) else None for v in values])
        case "number":
            return StoredColumn(name, kind, [_cell_number(value) for value in values])


def _cell_number(value: object) -> float | None:
    """None for what JSON has no number for."""
    return value if isinstance(value, int | float) and abs(value) < float("inf") else None
