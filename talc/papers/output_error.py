"""Output-error regression for fixed poles: filter the inputs, then everything is linear (variable projection).

One-step least squares shrinks the poles when outputs are noisy, and needs each output's predecessor. Fitting the free
run avoids both: for y[k] = B(q) / ((1 - p_1 q^-1) (1 - p_2 q^-1) ...) u[k] + c the inputs are filtered by the
denominator, and the numerator is a linear regression on the measured rows, wherever they are.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from talc import _kernel
from talc.frame import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Design:
    """Filtered inputs over the measured rows for one choice of poles."""

    poles: tuple[float, ...]
    """Real, 0 < p < 1, all different; none: a static or FIR model."""
    lags: int
    """Columns per input, nb + 1 of the largest order."""
    columns: FloatArray
    """(n, inputs * lags), input by input."""
    nuisance: FloatArray
    """(n, 1 + poles) the unpenalised columns: the constant and the decay of the unknown state before the record."""

    @classmethod
    def make(cls, scaled: FloatArray, poles: tuple[float, ...], lags: int, rows: BoolArray) -> "Design":
        """scaled: (T, inputs) z-scores; rows: (T,) which rows to keep. ValueError: poles that are not as stated."""
        if len(set(poles)) != len(poles) or any(not 0.0 < p < 1.0 for p in poles):
            raise ValueError(f"poles = {poles}: expected different ones between 0 and 1")
        # Before the record an input stood at its first value.
        before = np.vstack([np.repeat(scaled[:1], lags - 1, axis=0), scaled])
        t = np.arange(len(scaled))
        delayed = [before[lags - 1 - j : len(before) - j] for j in range(lags)]
        filtered = np.stack(delayed, axis=2).reshape(len(scaled), -1)
        for pole in poles:
            _kernel.lag(filtered, pole)
        columns = filtered if rows.all() else filtered[rows]
        nuisance = np.column_stack([np.ones(len(scaled)), *(p**t for p in poles)])
        return cls(poles, lags, columns, nuisance[rows])

    @cached_property
    def scale(self) -> FloatArray:
        """(inputs * lags,) standard deviation of each column, to which a ridge is relative."""
        # Column by column: all at once would need as much memory as the columns again.
        return np.array([max(float(column.std()), 1e-12) for column in self.columns.T])

    def of(self, coefficients: tuple[int, ...]) -> list[int]:
        """Positions of the leading columns of each input, as many as it has coefficients."""
        return [s * self.lags + j for s, count in enumerate(coefficients) for j in range(count)]


@dataclass(frozen=True, slots=True)
class Fit:
    """One regularised least-squares fit in scaled units."""

    b: tuple[FloatArray, ...]
    """(nb_s + 1,) per chosen input."""
    constant: float
    residual: FloatArray
    """(n,) of the free run."""
    unseen: FloatArray
    """(n - first block,) residual of each row after the first block under a fit that did not see its block."""
    leverage: FloatArray
    """(p, p) inverse of X'X / n of the chosen columns, with the ridge."""
    leverage_limit: float
    """Largest x' (X'X / n)^-1 x over the rows."""


def fit(design: Design, coefficients: tuple[int, ...], y: FloatArray, ridge: float, blocks: int) -> Fit:
    """Weighted least squares (Z22 eq. 5: weight 1 where measured) with a small ridge on unit-variance columns.

    coefficients: number for each offered input, 0: not in the model; y: (n,) scaled outputs; ridge: added to the normal
    equations' diagonal per row; blocks: consecutive parts of equal length that are left out in turn, because the
    residual on a fit's own rows says too little about other days. ValueError: fewer than two blocks, or too few rows.
    """
    if not 2 <= blocks <= len(y):
        raise ValueError(f"blocks = {blocks} for {len(y)} rows: expected at least 2, and a row for each")
    picked = design.of(coefficients)
    x = np.column_stack([design.columns[:, picked] / design.scale[picked], design.nuisance])
    damping = np.concatenate([np.full(len(picked), ridge * len(y)), np.zeros(design.nuisance.shape[1])])

    def solve(rows: FloatArray, outputs: FloatArray) -> FloatArray:
        augmented = np.vstack([rows, np.diag(np.sqrt(damping))])
        answer = np.linalg.lstsq(augmented, np.concatenate([outputs, np.zeros(damping.size)]), rcond=None)[0]
        return np.asarray(answer, dtype=np.float64)

    theta = solve(x, y)
    parts = np.array_split(np.arange(len(y)), blocks)[1:]
    unseen = np.concatenate([y[p] - x[p] @ solve(np.delete(x, p, axis=0), np.delete(y, p)) for p in parts])
    b = np.split(theta[: len(picked)] / design.scale[picked], np.cumsum([c for c in coefficients if c])[:-1])
    own, scale = x[:, : len(picked)], design.scale[picked]
    inverse = np.linalg.pinv(own.T @ own / len(y) + ridge * np.eye(len(picked)), hermitian=True)
    reach = float(np.einsum("ij,jk,ik->i", own, inverse, own).max(initial=0.0))
    residual = np.asarray(y - x @ theta, dtype=np.float64)
    return Fit(
        tuple(b) if picked else (), float(theta[len(picked)]), residual, unseen, inverse / np.outer(scale, scale), reach
    )
