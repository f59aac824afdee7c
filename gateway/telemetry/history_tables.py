"""Tables of the readings in history pages: a row for each time or interval, a column for each channel."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import NamedTuple

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from drivers.base import Quality
from gateway.model.reading_blocks import ReadingBlock, unpack
from gateway.telemetry.answers import HistoryBlock, HistoryPage

_GOOD = Quality.GOOD.value
_Array = NDArray[np.float64]
_Places = NDArray[np.int64]
TimeTable = tuple[_Array, _Array, list[str]]
"""Times, a row for each, and the columns' names."""


class _GoodReadings(NamedTuple):
    """The good readings of a page or a block."""

    time: _Array
    column: _Places
    value: _Array


class _ChannelColumns:
    """The column of each channel: those that were asked for, or all in the order in which they appear."""

    def __init__(self, channels: Sequence[str] | None) -> None:
        self._fixed = channels is not None
        self._of = {name: at for at, name in enumerate(channels or ())}

    @property
    def names(self) -> list[str]:
        return list(self._of)

    def good(self, page: HistoryPage) -> Iterator[_GoodReadings]:
        """The good readings of a page, including its blocks. Raises ValueError for a block that is damaged."""
        if not self._fixed:
            for name in page.names:
                self._of.setdefault(name, len(self._of))
        column_of = np.array([self._of.get(name, -1) for name in page.names], np.int64)
        for block in page.blocks:
            yield _of_block(block, page, column_of)
        if page.time:
            at = column_of[np.array(page.channel, np.int64)]
            good = np.array([quality == _GOOD for quality in page.quality], np.bool_) & (at >= 0)
            yield _GoodReadings(np.array(page.time, np.float64)[good], at[good], np.array(page.value, np.float64)[good])


def _of_block(block: HistoryBlock, page: HistoryPage, column_of: _Places) -> _GoodReadings:
    columns = unpack(ReadingBlock(*astuple(block)))
    column_of_number = np.full(1 << 16, -1)
    column_of_number[list(page.numbers)] = column_of
    at = column_of_number[columns.channel]
    good_number = page.qualities.index(_GOOD) if _GOOD in page.qualities else -1
    good = (columns.quality == good_number) & (at >= 0)
    if good.all():
        return _GoodReadings(columns.time, at, columns.value)
    return _GoodReadings(columns.time[good], at[good], columns.value[good])


def asked_s(begin: datetime, every_s: float) -> int | None:
    """The length of the intervals if the gateway makes means of exactly these; None: it does not."""
    whole = float(every_s).is_integer() and begin.timestamp() % (1 if every_s % 60 else 60) == 0
    return int(every_s) if whole and 1 <= every_s <= (3600 if every_s % 60 else 86400) else None


def as_read(pages: Iterable[HistoryPage], channels: Sequence[str] | None) -> TimeTable:
    """One row for each time at which a channel was read."""
    columns = _ChannelColumns(channels)
    parts = [part for page in pages for part in columns.good(page)]
    different = [_different(part.time) for part in parts]
    times, place = _different(np.concatenate([np.empty(0), *(own for own, _ in different)]))
    table, begin = np.full((len(times), len(columns.names)), np.nan), 0
    for part, (own, row) in zip(parts, different, strict=True):
        end = begin + len(own)
        table[place[begin:end][row], part.column] = part.value
        begin = end
    return times, table, columns.names


def _different(times: _Array) -> tuple[_Array, _Places]:
    """The different times, ascending, and the place of each time among them; ascending times need no sorting."""
    steps = np.diff(times)
    if (steps >= 0.0).all():
        first = np.concatenate([np.ones(min(1, len(times)), np.bool_), steps > 0.0])
        return times[first], np.cumsum(first) - 1
    return np.unique(times, return_inverse=True)


def interval_means(
    pages: Iterable[HistoryPage], channels: Sequence[str] | None, begin_s: float, end_s: float, every_s: float
) -> TimeTable:
    """The means of each interval; holds one page at a time."""
    if not every_s > 0:
        raise ValueError(f"every_s = {every_s!r}: expected more than 0")
    times = np.arange(begin_s, end_s, every_s)
    columns = _ChannelColumns(channels)
    sums, counts = np.zeros((len(times), 0)), np.zeros((len(times), 0))
    for page in pages:
        parts = list(columns.good(page))
        wider = ((0, 0), (0, len(columns.names) - sums.shape[1]))
        sums, counts = np.pad(sums, wider), np.pad(counts, wider)
        for at_s, column, value in parts:
            row = np.minimum(((at_s - begin_s) // every_s).astype(np.int64), len(times) - 1)
            np.add.at(sums, (row, column), value)
            np.add.at(counts, (row, column), 1.0)
    return times, np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0), columns.names
