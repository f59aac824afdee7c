"""Group-LASSO on the Gram matrix: min ||y - X t||² + lambda sum_s sqrt(g) ||t_s|| (Z22 eq. 8), groups of one size.

Accelerated proximal gradient (FISTA with restart) with the true duality gap. It serves to rank inputs; what is chosen
is fitted again without penalty.
"""

from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray


@dataclass(frozen=True, slots=True)
class Solution:
    """One point of the path."""

    coefficients: FloatArray
    """(groups, g)"""
    gap: float
    """Duality gap relative to ||y||²; 0 at the optimum."""
    iterations: int

    @property
    def active(self) -> tuple[int, ...]:
        """Groups that are not zero."""
        return tuple(int(i) for i in np.flatnonzero(np.linalg.norm(self.coefficients, axis=1)))


class GroupLasso:
    """One design, many outputs and penalties.

    Parameters
    ----------
    gram: (p, p) X'X, columns ordered group by group
    size: g, columns per group; p must be a multiple
    """

    def __init__(self, gram: FloatArray, size: int) -> None:
        if gram.ndim != 2 or gram.shape[0] != gram.shape[1] or gram.shape[0] % size:
            raise ValueError(f"gram has shape {gram.shape}: expected (p, p) with p a multiple of {size}")
        self._gram, self._size, self._groups = gram, size, gram.shape[0] // size
        self._weight = float(np.sqrt(size))
        self._lipschitz = 2.0 * float(np.linalg.eigvalsh(gram)[-1]) if gram.size else 1.0

    def largest(self, moment: FloatArray) -> float:
        """Smallest penalty at which everything is zero; moment: (p,) X'y."""
        return float(2.0 * np.linalg.norm(moment.reshape(self._groups, self._size), axis=1).max() / self._weight)

    def solve(
        self, moment: FloatArray, energy: float, penalty: float, start: FloatArray | None, tolerance: float, limit: int
    ) -> Solution:
        """Solve for one penalty.

        moment: (p,) X'y; energy: y'y; start: (groups, g) to begin from; tolerance: relative gap to stop at; limit:
        most iterations; the gap that was reached is in the answer either way.
        """
        theta = np.zeros(moment.size) if start is None else start.ravel().copy()
        ahead, momentum = theta.copy(), 1.0
        gap, iterations = np.inf, 0
        threshold = penalty * self._weight / self._lipschitz
        for iterations in range(1, limit + 1):
            moved = ahead - 2.0 * (self._gram @ ahead - moment) / self._lipschitz
            blocks = moved.reshape(self._groups, self._size)
            norms = np.linalg.norm(blocks, axis=1, keepdims=True)
            following = (blocks * np.maximum(0.0, 1.0 - threshold / np.maximum(norms, 1e-300))).ravel()
            if (ahead - following) @ (following - theta) > 0.0:  # momentum points uphill
                momentum = 1.0
            later = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
            ahead = following + (momentum - 1.0) / later * (following - theta)
            theta, momentum = following, later
            if iterations % 25 == 0:
                gap = self._gap(theta, moment, energy, penalty)
                if gap <= tolerance:
                    break
        gap = self._gap(theta, moment, energy, penalty)
        return Solution(theta.reshape(self._groups, self._size), gap, iterations)

    def _gap(self, theta: FloatArray, moment: FloatArray, energy: float, penalty: float) -> float:
        """Primal minus dual value; the dual point is the residual, scaled until it is feasible."""
        image = self._gram @ theta
        misfit = max(float(energy - 2.0 * theta @ moment + theta @ image), 0.0)
        norms = np.linalg.norm(theta.reshape(self._groups, self._size), axis=1)
        primal = misfit + penalty * self._weight * norms.sum()
        correlation = float(np.linalg.norm((moment - image).reshape(self._groups, self._size), axis=1).max())
        scale = min(1.0, penalty * self._weight / (2.0 * correlation)) if correlation > 0 else 1.0
        # Dual: 2 s r'y - s² r'r with r the residual.
        dual = 2.0 * scale * (energy - theta @ moment) - scale**2 * misfit
        return float(max(primal - dual, 0.0) / max(energy, 1e-300))
