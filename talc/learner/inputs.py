"""Relations between the inputs, and what the others imply about a missing one."""

import numpy as np

from talc.frame import BoolArray, FloatArray
from talc.steps import DAY_S, steps_in

_MEMORY_S = 14.0 * DAY_S
"""How long means and covariances are remembered."""
_LEAST_ROWS = 24
"""Until this many rows, a missing input keeps its last value."""
_RIDGE = 1e-4
"""Relative ridge of the regression on the other inputs."""
_LEAST_VARIANCE = 0.01
"""K²: what the others imply of an input is never more certain."""
_AWAY_STEPS = 2
_MOVED_SIGMA = 5.0
"""An input that returns this many standard deviations from its expected value is another sensor, or is mounted
elsewhere: its reference moves with it."""
_MOVED_LEAST = 1.0
"""It must also be this far from it, in its unit."""


class InputMemory:
    """Running mean and covariance of all inputs; a missing one is replaced by its conditional mean.

    Parameters
    ----------
    inputs: number of inputs
    step_s: grid step
    """

    def __init__(self, inputs: int, step_s: float) -> None:
        self._memory_rows = steps_in(_MEMORY_S, step_s)
        self.reference = np.zeros(inputs)
        """(n,) the reference of deviations; follows the first good value of an input until `anchor`."""
        self.known = np.zeros(inputs, dtype=np.bool_)
        """(n,) whether there was a good value."""
        self.last = np.zeros(inputs)
        """(n,) last values, filled."""
        self.away = np.zeros(inputs, dtype=np.int64)
        """(n,) steps since the last good value."""
        self.mean = np.zeros(inputs)
        self.covariance = np.zeros((inputs, inputs))
        self.rows = 0

    def anchor(self) -> None:
        """The present values are the reference."""
        self.reference = self.last.copy()

    def fill(
        self, values: FloatArray, valid: BoolArray, same: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray | None, BoolArray]:
        """Take in one row: (n,) values without gaps, the (n, n) covariance of what was filled in (None: nothing), and
        (n,) which inputs returned as other sensors. same: (n,) those that did not; None: none is known not to have."""
        new = valid & ~self.known
        if new.any():
            self.reference[new] = self.mean[new] = self.last[new] = values[new]
            self.known |= new
        missing = self.known & ~valid
        moved = np.zeros(len(values), dtype=np.bool_)
        back = valid & self.known & (self.away >= _AWAY_STEPS) & ~(np.False_ if same is None else same)
        if back.any() and self.rows >= _LEAST_ROWS:
            moved = self._moved(values, valid, back)
        self.away = np.where(valid, 0, self.away + 1)
        filled, doubt = np.where(valid, values, self.last), None
        if missing.any() and self.rows >= _LEAST_ROWS:
            filled[missing], among = self._conditional(filled, valid, missing)
            doubt = np.zeros_like(self.covariance)
            doubt[np.ix_(missing, missing)] = among
        self._remember(filled, doubt)
        self.last = filled
        return filled, doubt, moved

    def as_exchanged(self, values: FloatArray, valid: BoolArray, i: int, j: int) -> float:
        """How much nearer to what the other inputs imply two inputs are, if their values are exchanged: the difference
        of squared Mahalanobis distances; 0: too little is known."""
        if self.rows < _LEAST_ROWS:
            return 0.0
        pair = [i, j]
        wanted = np.zeros(len(values), dtype=np.bool_)
        wanted[pair] = True
        mean, among = self._conditional(values, valid & ~wanted, wanted)
        among = among + _LEAST_VARIANCE * np.eye(2)
        here, there = values[np.sort(pair)] - mean, values[np.sort(pair)[::-1]] - mean
        return float(here @ np.linalg.solve(among, here) - there @ np.linalg.solve(among, there))

    def _conditional(self, values: FloatArray, given: BoolArray, wanted: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of the wanted inputs, given others: of a joint normal distribution."""
        own = self.covariance[np.ix_(wanted, wanted)]
        scale = np.sqrt(np.maximum(np.diag(self.covariance), 1e-12))
        given = given & self.known
        if not given.any():
            return self.mean[wanted], own
        unit = scale[given]
        across = self.covariance[np.ix_(given, wanted)] / unit[:, None]
        correlation = self.covariance[np.ix_(given, given)] / np.outer(unit, unit)
        gain = np.linalg.solve(correlation + _RIDGE * np.eye(len(unit)), across)
        mean = self.mean[wanted] + ((values - self.mean)[given] / unit) @ gain
        left = own - across.T @ gain
        return mean, 0.5 * (left + left.T)

    def _moved(self, values: FloatArray, valid: BoolArray, back: BoolArray) -> BoolArray:
        expected, among = self._conditional(values, valid & ~back, back)
        off = values[back] - expected
        far = np.abs(off) > _MOVED_SIGMA * np.sqrt(np.maximum(np.diag(among), 0.0)) + _MOVED_LEAST
        moved = np.zeros(len(values), dtype=np.bool_)
        moved[np.flatnonzero(back)[far]] = True
        self.reference[moved] += off[far]
        self.mean[moved] += off[far]
        return moved

    def _remember(self, filled: FloatArray, doubt: FloatArray | None) -> None:
        self.rows += 1
        share = max(1.0 / self.rows, 1.0 / self._memory_rows)
        off = filled - self.mean
        self.mean = self.mean + share * off
        self.covariance = (1.0 - share) * (self.covariance + share * np.outer(off, off))
        if doubt is not None:
            self.covariance += share * doubt
