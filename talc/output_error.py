"""Output-error regression for a fixed pole: filter the inputs, then everything is linear (variable projection).

One-step least squares shrinks the poles when outputs are noisy, and needs each output's predecessor. Fitting the free
run itself does neither: for y[k] = B(q) / (1 - p q^-1) u[k] + c the inputs are filtered by the denominator, and the
numerator is a linear regression on those rows that were measured, wherever they lie.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from talc.frame import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Design:
    """Filtered inputs over the measured rows for one pole."""

    pole: float
    lags: int
    """Coefficients per input, nb + 1."""
    columns: FloatArray
    """(n, inputs * lags), input by input."""
    nuisance: FloatArray
    """(n, 1 or 2) what is not penalised: the constant and the decay of the unknown state before the record."""

    @classmethod
    def make(cls, scaled: FloatArray, pole: float, lags: int, rows: BoolArray) -> "Design":
        """scaled: (T, inputs) z-scores; rows: (T,) which rows to keep."""
        t = np.arange(len(scaled))
        blocks = []
        for s in range(scaled.shape[1]):
            # Before the record an input stood at its first value.
            u = scaled[:, s]
            rest = u[0] / (1.0 - pole)
            for j in range(lags):
                delayed = np.concatenate([np.full(j, u[0]), u[: len(u) - j]])
                blocks.append(lfilter([1.0], [1.0, -pole], delayed, zi=[pole * rest])[0])
        constant = np.ones((len(scaled), 1))
        nuisance = constant if pole == 0.0 else np.column_stack([constant, pole**t])
        columns = np.column_stack(blocks) if blocks else np.zeros((len(scaled), 0))
        return cls(pole, lags, columns[rows], nuisance[rows])

    def of(self, inputs: tuple[int, ...]) -> FloatArray:
        """(n, len(inputs) * lags) the columns of some inputs."""
        picked = [s * self.lags + j for s in inputs for j in range(self.lags)]
        return self.columns[:, picked]


@dataclass(frozen=True, slots=True)
class Fit:
    """Coefficients of one least-squares fit in scaled units."""

    b: FloatArray
    """(inputs, lags)"""
    constant: float
    residual: FloatArray
    """(n,)"""


def fit(design: Design, inputs: tuple[int, ...], y: FloatArray, ridge: float) -> Fit:
    """Weighted least squares (Z22 eq. 5: weight 1 where measured) with a small ridge on unit-variance columns.

    y: (n,) scaled outputs; ridge: added to the normal equations' diagonal per row.
    """
    x = design.of(inputs)
    scale = np.maximum(x.std(axis=0), 1e-12) if x.size else np.ones(0)
    full = np.column_stack([x / scale, design.nuisance])
    damping = np.zeros(full.shape[1])
    damping[: x.shape[1]] = np.sqrt(ridge * len(y))
    augmented = np.vstack([full, np.diag(damping)])
    solution, *_ = np.linalg.lstsq(augmented, np.concatenate([y, np.zeros(full.shape[1])]), rcond=None)
    b = (solution[: x.shape[1]] / scale).reshape(len(inputs), design.lags)
    return Fit(b, float(solution[x.shape[1]]), np.asarray(y - full @ solution, dtype=np.float64))
