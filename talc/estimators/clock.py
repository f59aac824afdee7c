"""The grid step of each row, over any number of calls."""

from copy import copy

import numpy as np

from talc.estimators.rows import Inputs, more_than_zero, refuse_unsure_seconds
from talc.frame import IntArray
from talc.steps import StepCounter

_STEP_S = 300.0
"""Step of rows without times, if none is given: the gateway's."""


class RowClock:
    """Counts the steps of rows with times, or of rows that follow each other without one.

    Parameters
    ----------
    first: the rows that begin
    step_s: grid step; None: their median spacing
    """

    def __init__(self, first: Inputs, step_s: float | None) -> None:
        if step_s is not None:
            more_than_zero("step_s", step_s)
        self._counter: StepCounter | None = None
        self._last = -1
        self._zoned = first.zoned
        self.step_s = step_s or _STEP_S
        if first.time_s is not None:
            if step_s is None and len(first.time_s) > 1:
                self.step_s = float(np.median(np.diff(first.time_s)))
                refuse_unsure_seconds(first, self.step_s)
            self._counter = StepCounter(self.step_s, float(first.time_s[0]), 0)

    def take(self, rows: Inputs) -> IntArray:
        """(T,) the steps of the next rows. ValueError: they are not later than those before, or too dense."""
        has_times = rows.time_s is not None
        if has_times != (self._counter is not None):
            given, lack = (
                ("rows with times", "these have none") if self._counter else ("rows without times", "these have")
            )
            raise ValueError(f"it was fitted to {given}; {lack}: give times for all rows, or for none")
        if has_times and rows.zoned is not self._zoned:
            kinds = {None: "seconds", True: "dates with a time zone", False: "dates without a time zone, read as UTC"}
            raise ValueError(
                f"it was fitted to {kinds[self._zoned]}; these times are {kinds[rows.zoned]}: give both in the same "
                "way, such as with tz_localize or tz_convert of pandas"
            )
        if self._counter is None or rows.time_s is None:
            index = self._last + 1 + np.arange(len(rows.values))
        else:
            counter = copy(self._counter)
            index = counter.of(rows.time_s)
            late = np.flatnonzero(np.diff(index, prepend=self._last) <= 0)
            if late.size and late[0] == 0:
                raise ValueError(
                    f"row 0 is not later than the last row before it (step {index[0]} after {self._last}): "
                    "rows follow those that were fitted"
                )
            if late.size:
                raise ValueError(
                    f"rows {int(late[0]) - 1} and {int(late[0])} are in one step of {self.step_s:g} s: average them "
                    f'first, as df.resample("{self.step_s:g}s").mean() does, or give a smaller step_s'
                )
            self._counter = counter  # only now: refused rows leave no trace
        self._last = int(index[-1])
        return index

    def ahead(self) -> "RowClock":
        """A copy, to look at rows without remembering them."""
        return copy(self)
