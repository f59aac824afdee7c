"""Group-LASSO on the Gram matrix: min ||y - X t||² + lambda sum_s sqrt(g_s) ||t_s|| (Z22 eq. 8), solved exactly.

Thermal regressors are nearly collinear, so first-order methods stop far from the optimum without showing it. The kernel
finds the support by a few passes and finishes on it by Newton's method; the duality gap decides when to stop.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from talc import _kernel
from talc.frame import FloatArray

_ROUNDS = 200
_LARGEST_GROUP = 64
"""Largest group for which the kernel has room."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The optimum for one penalty."""

    penalty: float
    coefficients: tuple[FloatArray, ...]
    """(g_s,) per group."""
    objective: float
    gap: float
    """Duality gap relative to the objective; 0 at the optimum."""

    @property
    def active(self) -> tuple[int, ...]:
        """Groups that are not zero."""
        return tuple(s for s, t in enumerate(self.coefficients) if t.any())


class GroupLasso:
    """One regression, many penalties.

    Parameters
    ----------
    gram: (p, p) X'X, columns ordered group by group
    sizes: columns of each group; they sum to p
    """

    def __init__(self, gram: FloatArray, sizes: Sequence[int]) -> None:
        if any(size < 1 for size in sizes) or gram.shape != (sum(sizes), sum(sizes)):
            raise ValueError(
                f"gram has shape {gram.shape}, sizes {tuple(sizes)}: expected (p, p), p the sum of sizes >= 1"
            )
        if max(sizes, default=1) > _LARGEST_GROUP:
            raise ValueError(f"sizes {tuple(sizes)}: expected at most {_LARGEST_GROUP} columns in a group")
        if not np.isfinite(gram).all():
            raise ValueError("gram holds a value that is not finite")
        self._gram = np.ascontiguousarray(gram, dtype=np.float64)
        self._sizes = list(sizes)
        self._first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(int).tolist() if sizes else []

    def largest(self, moment: FloatArray) -> float:
        """Smallest penalty at which everything is zero; moment: (p,) X'y."""
        lengths = [2.0 * np.linalg.norm(part) / np.sqrt(part.size) for part in self._parts(moment)]
        return float(max(lengths, default=0.0))

    def solve(
        self, moment: FloatArray, energy: float, penalty: float, start: Solution | None = None, tolerance: float = 1e-8
    ) -> Solution:
        """Solve for one penalty.

        moment: (p,) X'y; energy: y'y; start: the solution of another penalty to begin from; tolerance: relative
        duality gap to stop at (not reached after 200 rounds: the answer's gap says so). ValueError: a wrong shape, a
        negative penalty or a number that is not finite.
        """
        if moment.shape != (len(self._gram),):
            raise ValueError(f"moment has shape {moment.shape}: expected ({len(self._gram)},)")
        if not (np.isfinite(moment).all() and np.isfinite(energy) and energy >= 0.0):
            raise ValueError("moment or energy is not finite, or energy is negative")
        if not (np.isfinite(penalty) and penalty >= 0.0):
            raise ValueError(f"penalty = {penalty}: expected 0 or more")
        theta = np.zeros(moment.size) if start is None else np.concatenate([*start.coefficients, np.zeros(0)])
        # The kernel reads and writes the start without looking at its length.
        if theta.shape != moment.shape or not np.isfinite(theta).all():
            raise ValueError(f"start has {theta.size} coefficients: expected {moment.size}, all finite")
        objective, gap, _, _ = _kernel.group_lasso(
            self._gram, moment, energy, self._first, self._sizes, penalty, tolerance, _ROUNDS, theta
        )
        return Solution(penalty, tuple(self._parts(theta)), objective, gap)

    def path(
        self, moment: FloatArray, energy: float, penalties: Iterable[float], tolerance: float = 1e-8
    ) -> Iterator[Solution]:
        """Solutions for descending penalties, each started from the previous one."""
        last = None
        for penalty in penalties:
            last = self.solve(moment, energy, penalty, last, tolerance)
            yield last

    def _parts(self, vector: FloatArray) -> list[FloatArray]:
        return np.split(vector, self._first[1:]) if self._sizes else []
