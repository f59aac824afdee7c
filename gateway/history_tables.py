"""Tables of the readings in history pages: a row for each time or interval, a column for each channel."""

from collections.abc import Iterable, Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from drivers.base import Quality
from gateway.telemetry import HistoryPage

_GOOD = Quality.GOOD.value
_Array = NDArray[np.float64]
_Places = NDArray[np.int64]


class _ChannelColumns:
    """The column of each channel: those that were asked for, or all in the order in which they appear."""

    def __init__(self, channels: Sequence[str] | None) -> None:
        self._fixed = channels is not None
        self._of = {name: at for at, name in enumerate(channels or ())}

    @property
    def names(self) -> list[str]:
        return list(self._of)

    def good(self, page: HistoryPage) -> tuple[_Array, _Places, _Array]:
        """Time, column and value of the good readings of a page."""
        if not self._fixed:
            for name in page.names:
                self._of.setdefault(name, len(self._of))
        column_of = np.array([self._of.get(name, -1) for name in page.names], np.int64)
        good = np.array([quality == _GOOD for quality in page.quality], np.bool_)
        at = column_of[np.array(page.channel, np.int64)]
        return np.array(page.time, np.float64)[good], at[good], np.array(page.value, np.float64)[good]


def asked_s(begin: datetime, every_s: float) -> int | None:
    """The length of intervals that a gateway makes means of; None: of these it does not, or not of just these."""
    whole = float(every_s).is_integer() and begin.timestamp() % (1 if every_s % 60 else 60) == 0
    return int(every_s) if whole and 1 <= every_s <= (3600 if every_s % 60 else 86400) else None


def as_read(pages: Iterable[HistoryPage], channels: Sequence[str] | None) -> tuple[_Array, _Array, list[str]]:
    """Times, a row for each, and the columns' names."""
    columns = _ChannelColumns(channels)
    parts = [columns.good(page) for page in pages]
    times, row = np.unique(np.concatenate([part[0] for part in parts]), return_inverse=True)
    table = np.full((len(times), len(columns.names)), np.nan)
    table[row, np.concatenate([part[1] for part in parts])] = np.concatenate([part[2] for part in parts])
    return times, table, columns.names


def interval_means(
    pages: Iterable[HistoryPage], channels: Sequence[str] | None, begin_s: float, end_s: float, every_s: float
) -> tuple[_Array, _Array, list[str]]:
    """The same for intervals; holds one page at a time."""
    if not every_s > 0:
        raise ValueError(f"every_s = {every_s!r}: expected more than 0")
    times = np.arange(begin_s, end_s, every_s)
    columns = _ChannelColumns(channels)
    sums, counts = np.zeros((len(times), 0)), np.zeros((len(times), 0))
    for page in pages:
        at_s, column, value = columns.good(page)
        wider = ((0, 0), (0, len(columns.names) - sums.shape[1]))
        sums, counts = np.pad(sums, wider), np.pad(counts, wider)
        row = np.minimum(((at_s - begin_s) // every_s).astype(np.int64), len(times) - 1)
        np.add.at(sums, (row, column), value)
        np.add.at(counts, (row, column), 1.0)
    return times, np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0), columns.names
