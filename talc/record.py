"""The controller's record: consecutive grid steps of inputs and measurements, growing."""

import numpy as np

from talc.frame import LARGEST_ERROR, LARGEST_INPUT, BoolArray, FloatArray, Frame, Frames
from talc.names import THERMAL_ERRORS

_FIRST_CAPACITY = 512
_ERRORS = len(THERMAL_ERRORS)


class Record:
    """Rows of consecutive grid steps.

    A missing input is filled with its last good value. Values before its first good one are filled with that one as
    soon as it arrives: a sensor that starts late is not lost. NaN: there was none yet. Numbers that no sensor and no
    machine can report (talc.frame) count as missing.

    Parameters
    ----------
    inputs: number of inputs
    window: rows to keep; None: all
    """

    def __init__(self, inputs: int, window: int | None) -> None:
        self._n, self._window = inputs, window
        self._inputs = np.empty((_FIRST_CAPACITY, inputs))
        self._valid = np.empty((_FIRST_CAPACITY, inputs), dtype=np.bool_)
        self._measured = np.empty((_FIRST_CAPACITY, _ERRORS))
        self._rows = 0
        self.last_k: int | None = None

    def __len__(self) -> int:
        return self._rows

    @property
    def inputs(self) -> FloatArray:
        """(T, n) filled inputs, oldest first."""
        return self._inputs[: self._rows]

    @property
    def valid(self) -> BoolArray:
        """(T, n)"""
        return self._valid[: self._rows]

    @property
    def measured(self) -> FloatArray:
        """(T, 9) NaN where nothing was measured."""
        return self._measured[: self._rows]

    def append(self, frame: Frame) -> None:
        """The next step. ValueError: a wrong shape, or an index that is not the next one."""
        if frame.inputs.shape != (self._n,) or frame.valid.shape != (self._n,):
            raise ValueError(f"inputs {frame.inputs.shape}, valid {frame.valid.shape}: expected ({self._n},)")
        if self.last_k is not None and frame.k != self.last_k + 1:
            raise ValueError(f"k = {frame.k}: expected {self.last_k + 1}")
        valid = _usable(frame.inputs, frame.valid)
        before = self._inputs[self._rows - 1] if self._rows else np.full(self._n, np.nan)
        self._make_room()
        self._inputs[self._rows] = np.where(valid, frame.inputs, before)
        self._valid[self._rows] = valid
        self._measured[self._rows] = np.nan
        if frame.measurement is not None:
            self._measured[self._rows] = _possible(frame.measurement.errors)
        late = valid & np.isnan(before)
        if late.any():
            self._inputs[: self._rows, late] = frame.inputs[late]
        self._rows += 1
        self.last_k = frame.k

    def append_gap(self, until_k: int) -> None:
        """Empty steps, up to but not including `until_k`."""
        nothing = np.full(self._n, np.nan), np.zeros(self._n, dtype=np.bool_)
        while self.last_k is not None and self.last_k + 1 < until_k:
            self.append(Frame(self.last_k + 1, *nothing))

    def restore(self, inputs: FloatArray, valid: BoolArray, measured: FloatArray, last_k: int | None) -> None:
        """Replace the rows by these. ValueError: shapes that do not fit together."""
        rows = len(inputs)
        if inputs.shape != (rows, self._n) or valid.shape != inputs.shape or measured.shape != (rows, _ERRORS):
            raise ValueError(
                f"inputs {inputs.shape}, valid {valid.shape}, measured {measured.shape}: shapes of one record differ"
            )
        self._rows, self.last_k = rows, last_k
        spare = max(_FIRST_CAPACITY - rows, rows)
        self._inputs = np.concatenate([inputs, np.empty((spare, self._n))])
        self._valid = np.concatenate([valid, np.zeros((spare, self._n), dtype=np.bool_)])
        self._measured = np.concatenate([measured, np.empty((spare, _ERRORS))])

    def clear(self) -> None:
        """Delete all rows."""
        self._rows, self.last_k = 0, None

    def _make_room(self) -> None:
        if self._window is not None and self._rows >= 2 * self._window:
            for array in (self._inputs, self._valid, self._measured):
                array[: self._window] = array[self._rows - self._window : self._rows].copy()
            self._rows = self._window
        if self._rows == len(self._inputs):
            self._inputs = np.concatenate([self._inputs, np.empty_like(self._inputs)])
            self._valid = np.concatenate([self._valid, np.empty_like(self._valid)])
            self._measured = np.concatenate([self._measured, np.empty_like(self._measured)])


def refilled(first: FloatArray, rows: int, frames: Frames, last_k: int) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Inputs (rows, n), valid and measured of a record that ended at `last_k`, from the frames that it was made of.

    first: (n,) inputs of its oldest row; what was filled in there came before the frames, or after them
    """
    at = frames.k - (last_k + 1 - rows)
    own = (at >= 0) & (at < rows)
    inputs, measured = np.full((rows, len(first)), np.nan), np.full((rows, _ERRORS), np.nan)
    valid = np.zeros(inputs.shape, dtype=np.bool_)
    inputs[at[own]], measured[at[own]] = frames.inputs[own], _possible(frames.measured[own])
    valid[at[own]] = _usable(frames.inputs[own], frames.valid[own])
    inputs[0] = first
    latest = np.maximum.accumulate(np.where(valid, np.arange(rows)[:, None], 0), axis=0)
    return np.take_along_axis(inputs, latest, axis=0), valid, measured


def _usable(inputs: FloatArray, valid: BoolArray) -> BoolArray:
    return valid & (np.abs(inputs) <= LARGEST_INPUT)  # NaN compares false


def _possible(errors: FloatArray) -> FloatArray:
    return np.where(np.abs(errors) <= LARGEST_ERROR, errors, np.nan)
