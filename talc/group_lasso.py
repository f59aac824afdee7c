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


class Gram:
    """X'X, X'y and y'y of the rows seen so far: later rows are added without rebuilding anything.

    Parameters
    ----------
    columns: of X
    """

    def __init__(self, columns: int) -> None:
        self.rows = 0
        self.gram: FloatArray = np.zeros((columns, columns))
        self.moment: FloatArray = np.zeros(columns)
        self.energy = 0.0

    def add(self, x: FloatArray, y: FloatArray) -> None:
        """More rows: x (n, columns), y (n,). ValueError: shapes that do not fit, or values that are not finite."""
        if x.ndim != 2 or x.shape != (len(y), self.moment.size):
            raise ValueError(f"x has shape {x.shape}, y {y.shape}: expected (n, {self.moment.size}) and (n,)")
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ValueError("x or y holds a value that is not finite")
        self.gram += x.T @ x
        self.moment += x.T @ y
        self.energy += float(y @ y)
        self.rows += len(y)

    def without(self, free: Sequence[int]) -> "Gram":
        """The same regression with unpenalised columns projected out (Schur complement), and dropped."""
        out = np.asarray(free, dtype=np.intp)
        kept = np.setdiff1d(np.arange(self.moment.size), out)
        own = self.gram[np.ix_(out, out)]
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        onto = np.linalg.pinv(own / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        across = self.gram[np.ix_(out, kept)]
        rest = Gram(kept.size)
        rest.rows = self.rows
        rest.gram = self.gram[np.ix_(kept, kept)] - across.T @ onto @ across
        rest.moment = self.moment[kept] - across.T @ onto @ self.moment[out]
        rest.energy = max(self.energy - float(self.moment[out] @ onto @ self.moment[out]), 0.0)
        return rest


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
