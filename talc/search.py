"""Choice of poles, inputs and orders by what predicts rows that the fit has not seen. Deterministic.

Each row of the record belongs to a block of consecutive rows. A candidate is fitted without one block after the other,
and judged on that one: n ln(SSE / n) + ln(n) (poles + coefficients), a BIC on unseen residuals. The first block is
always seen, because the decay of the unknown first state shows only there. All of it rests on each block's Gram
matrix, so its cost does not grow with the record.

Single steps (an input less, more, exchanged, an order up or down) go on while the cost falls. They start from the best
set on the Group-LASSO path: the path alone adds inputs in clumps, and its bias favours strong wrong inputs over weak
right ones; single steps alone begin from nothing. Each choice of poles is searched by itself, because the way from
one's best set to another's may lead uphill.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from talc import _kernel
from talc._kernel import Progress
from talc.frame import FloatArray
from talc.group_lasso import GroupLasso
from talc.output_error import Design

BLOCKS = 6
"""Of 4 h on the first day. Fewer say less, more let a fit see what lies around each block."""
RIDGE = 1e-4
"""Relative to unit-variance columns; tames near-equal temperatures without moving a good fit."""
_PENALTIES = np.geomspace(0.6, 2e-3, 10)
"""Points of the path, relative to the smallest penalty that leaves no input."""
_GAP = 1e-6
_ROUNDING = 1e-10
"""Share of a column that is left when all of it is projected out."""
_FLOOR = 1e-12
"""Least mean square residual, in scaled units: an exact fit is not infinitely good."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What a search found."""

    design: Design
    coefficients: tuple[int, ...]
    """Of each offered input; 0: not chosen."""
    criterion: float


class Candidates:
    """The regressions of one pattern of measured rows: every choice of poles, all offered inputs.

    Parameters
    ----------
    designs: with the same rows, lags and inputs
    inputs: how many are offered
    """

    def __init__(self, designs: Sequence[Design], inputs: int) -> None:
        self._designs, self._inputs = tuple(designs), inputs
        self._parts = np.array_split(np.arange(len(designs[0].nuisance)), BLOCKS)
        # Different numbers of poles have different nuisances; a column of zeros does no harm.
        widest = max(d.nuisance.shape[1] for d in designs)
        self._rows = [
            np.column_stack(
                [d.columns / d.scale, d.nuisance, np.zeros((len(d.nuisance), widest - d.nuisance.shape[1]))]
            )
            for d in designs
        ]
        self._gram = np.array([[x[part].T @ x[part] for part in self._parts] for x in self._rows])

    def choose(
        self,
        y: FloatArray,
        most: int,
        fixed: tuple[int, ...] | None = None,
        progress: Progress | None = None,
        judged_by: Literal["unseen", "seen"] = "unseen",
    ) -> Choice:
        """The best model of y (n,), in scaled units.

        most: largest number of inputs; fixed: these inputs, only poles and orders are chosen; progress: reports the
        share done and may stop the search, which then answers with the best so far; judged_by: residuals of blocks
        left out, or of all rows as in the plain BIC.
        """
        moment = np.array([[x[part].T @ y[part] for part in self._parts] for x in self._rows])
        energy = np.array([y[part] @ y[part] for part in self._parts])
        rows = len(y) - (len(self._parts[0]) if judged_by == "unseen" else 0)
        starts = [self._starts(d, moment[d], energy, most, fixed) for d in range(len(self._designs))]
        chosen, coefficients, cost = _kernel.search(
            self._gram,
            moment,
            energy,
            np.array([len(d.poles) for d in self._designs], dtype=np.int64),
            starts,
            self._inputs,
            self._designs[0].lags,
            RIDGE * len(y),
            judged_by == "unseen",
            float(rows),
            math.log(len(y)),
            _FLOOR * rows,
            most,
            fixed is not None,
            progress,
        )
        return Choice(self._designs[chosen], tuple(coefficients), cost)

    @cached_property
    def _paths(self) -> list[tuple[GroupLasso, FloatArray, FloatArray, FloatArray]]:
        """Per design: the path's solver with the nuisance projected out, the columns' lengths, the projections."""
        lags = self._designs[0].lags
        p = self._inputs * lags
        paths = []
        for gram in self._gram.sum(axis=1):
            inverse = np.linalg.pinv(gram[p:, p:], rcond=1e-12, hermitian=True)
            onto = inverse @ gram[p:, :p]
            rest = gram[:p, :p] - gram[:p, p:] @ onto
            # A column that the nuisance explains (one spike at the first row) leaves rounding, even negative.
            empty = np.diag(rest) <= _ROUNDING * np.diag(gram)[:p]
            length = np.where(empty, np.inf, np.sqrt(np.maximum(np.diag(rest), 1e-12)))
            scaled = rest / np.outer(length, length) + np.diag(empty.astype(np.float64))
            paths.append((GroupLasso(scaled, [lags] * self._inputs), length, onto, inverse))
        return paths

    def _starts(
        self, d: int, moment: FloatArray, energy: FloatArray, most: int, fixed: tuple[int, ...] | None
    ) -> list[list[int]]:
        lags = self._designs[0].lags
        if fixed is not None:
            return [[lags if s in fixed else 0 for s in range(self._inputs)]]
        p = self._inputs * lags
        lasso, length, onto, inverse = self._paths[d]
        total = moment.sum(axis=0)
        products = (total[:p] - onto.T @ total[p:]) / length
        left = max(float(energy.sum() - total[p:] @ inverse @ total[p:]), 0.0)
        sets = _path(lasso, products, left, most)
        return [[lags if s in chosen else 0 for s in range(self._inputs)] for chosen in sets]


def _path(lasso: GroupLasso, moment: FloatArray, energy: float, most: int) -> list[tuple[int, ...]]:
    """Different sets of inputs along the path, the empty one first."""
    found: list[tuple[int, ...]] = [()]
    for solution in lasso.path(moment, energy, _PENALTIES * lasso.largest(moment), _GAP):
        if len(solution.active) > most:
            # The strongest ones still are a proposal; further down the path there are only more.
            strength = [np.linalg.norm(part) for part in solution.coefficients]
            found.append(tuple(sorted(int(i) for i in np.argsort(strength, kind="stable")[::-1][:most])))
            break
        found.append(solution.active)
    return list(dict.fromkeys(found))
