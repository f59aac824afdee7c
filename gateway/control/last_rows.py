"""The last rows of inputs, in a fixed piece of memory."""

import numpy as np

from talc.frame import BoolArray, FloatArray


class LastRows:
    """Rows of m inputs and their masks, at most `most`; another one takes the place of the oldest.

    As two arrays: a row of 36 inputs takes 324 bytes, as two separate objects 780. What is not used yet takes none.

    Parameters
    ----------
    inputs: m, number of inputs
    most: largest number of rows, 1 or more
    """

    def __init__(self, inputs: int, most: int) -> None:
        self._inputs, self._valid = np.empty((most, inputs)), np.empty((most, inputs), dtype=np.bool_)
        self._next = self._rows = 0

    def __len__(self) -> int:
        return self._rows

    def append(self, inputs: FloatArray, valid: BoolArray) -> None:
        """The next row, (m,) each."""
        self._inputs[self._next], self._valid[self._next] = inputs, valid
        self._next = (self._next + 1) % len(self._inputs)
        self._rows = min(self._rows + 1, len(self._inputs))

    def append_gap(self, rows: int) -> None:
        """Append this many rows without values: NaN, none valid."""
        for _ in range(min(rows, len(self._inputs))):
            self.append(np.full(self._inputs.shape[1], np.nan), np.zeros(self._inputs.shape[1], dtype=np.bool_))

    def part(self, rows: slice) -> tuple[FloatArray, BoolArray]:
        """Copies of some rows, (T, m) each; 0 is the oldest."""
        places = (self._next - self._rows + np.arange(*rows.indices(self._rows))) % len(self._inputs)
        return self._inputs[places], self._valid[places]
