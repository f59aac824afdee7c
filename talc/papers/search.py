"""Chooses poles, inputs and orders by how well they predict rows that the fit has not seen. Deterministic.

Each row of the record belongs to a block of consecutive rows. A candidate is fitted with one block left out at a time,
and judged on that block: n ln(SSE / n) + ln(n) (poles + coefficients), a BIC on unseen residuals. The first block is
always seen, because the decay of the unknown first state shows only there. Everything is computed from each block's
Gram matrix, so the cost does not grow with the record.

Single steps (an input less, more, exchanged, an order up or down) continue while the cost falls. They start from the
best set on the Group-LASSO path: the path alone adds inputs in clumps, and its bias favours strong wrong inputs over
weak right ones; single steps alone would start from nothing. Each choice of poles is searched separately, because the
way from one's best set to another's may lead uphill.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from talc import _kernel
from talc.frame import FloatArray
from talc.papers.group_lasso import GroupLasso
from talc.papers.output_error import Design

BLOCKS = 6
"""Number of blocks: of 4 h each on the first day. Fewer blocks say less; more let a fit see the neighbourhood of each
block."""
RIDGE = 1e-4
"""Relative to unit-variance columns; tames near-equal temperatures without affecting a good fit."""
_PENALTIES = np.geomspace(0.6, 2e-3, 10)
"""Points of the path, relative to the smallest penalty that leaves no input."""
_GAP = 1e-6
_ROUNDING = 1e-10
"""Share of a column that remains when all of it is projected out."""
_FLOOR = 1e-12
"""Least mean square residual, in scaled units: an exact fit is not infinitely good."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The result of a search."""

    poles: tuple[float, ...]
    coefficients: tuple[int, ...]
    """For each offered input; 0: not chosen."""
    criterion: float


class Candidates:
    """The regressions of one pattern of measured rows: every choice of poles, all offered inputs.

    Parameters
    ----------
    pole_sets: to choose from
    make: the design of one of them, all with the same rows, lags and inputs. They are made one after the other and not
        kept: over weeks of data their rows are what needs memory
    outputs: (n, m) the outputs to be explained, in scaled units
    inputs: number of offered inputs
    """

    def __init__(
        self,
        pole_sets: Sequence[tuple[float, ...]],
        make: Callable[[tuple[float, ...]], Design],
        outputs: FloatArray,
        inputs: int,
    ) -> None:
        parts = np.array_split(np.arange(len(outputs)), BLOCKS)
        blocks = [slice(int(part[0]), int(part[-1]) + 1) for part in parts]
        self._poles, self._rows, self._inputs = tuple(pole_sets), len(outputs), inputs
        # Different numbers of poles have different nuisances; columns of zeros do no harm.
        nuisance = 1 + max(len(poles) for poles in pole_sets)
        for d, poles in enumerate(pole_sets):
            design = make(poles)
            if not d:
                self._lags, width = design.lags, inputs * design.lags + nuisance
                self._gram = np.zeros((len(pole_sets), BLOCKS, width, width))
                self._moment = np.zeros((outputs.shape[1], len(pole_sets), BLOCKS, width))
            for b, block in enumerate(blocks):
                gram, moment = _gram(design, block), _moment(design, block, outputs[block])
                self._gram[d, b, : len(gram), : len(gram)] = gram
                self._moment[:, d, b, : len(gram)] = moment.T
            del design  # before the next one is made
        self._energy = np.array([(outputs[block] ** 2).sum(axis=0) for block in blocks]).T
        self._unseen_rows = len(outputs) - len(parts[0])

    def choose(
        self,
        output: int,
        most: int,
        fixed: tuple[int, ...] | None = None,
        judged_by: Literal["unseen", "seen"] = "unseen",
    ) -> Choice:
        """The best model of one output, by its column.

        most: largest number of inputs; fixed: these inputs, only poles and orders are chosen; judged_by: residuals of
        blocks left out, or of all rows as in the plain BIC.
        """
        moment, energy = np.ascontiguousarray(self._moment[output]), np.ascontiguousarray(self._energy[output])
        rows = self._unseen_rows if judged_by == "unseen" else self._rows
        starts = [self._starts(d, moment[d], energy, most, fixed) for d in range(len(self._poles))]
        chosen, coefficients, cost = _kernel.search(
            self._gram,
            moment,
            energy,
            np.array([len(poles) for poles in self._poles], dtype=np.int64),
            starts,
            self._inputs,
            self._lags,
            RIDGE * self._rows,
            judged_by == "unseen",
            float(rows),
            math.log(self._rows),
            _FLOOR * rows,
            most,
            fixed is not None,
        )
        return Choice(self._poles[chosen], tuple(coefficients), cost)

    @cached_property
    def _paths(self) -> list[tuple[GroupLasso, FloatArray, FloatArray, FloatArray]]:
        """Per design: the path's solver with the nuisance projected out, the columns' lengths, the projections."""
        lags, p = self._lags, self._inputs * self._lags
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
        lags = self._lags
        if fixed is not None:
            return [[lags if s in fixed else 0 for s in range(self._inputs)]]
        p = self._inputs * lags
        lasso, length, onto, inverse = self._paths[d]
        total = moment.sum(axis=0)
        products = (total[:p] - onto.T @ total[p:]) / length
        left = max(float(energy.sum() - total[p:] @ inverse @ total[p:]), 0.0)
        sets = _path(lasso, products, left, most)
        return [[lags if s in chosen else 0 for s in range(self._inputs)] for chosen in sets]


def _gram(design: Design, block: slice) -> FloatArray:
    """(P, P) of the block's rows: inputs' columns of unit variance, then the nuisance."""
    x, nuisance, scale = design.columns[block], design.nuisance[block], design.scale[:, None]
    across = x.T @ nuisance / scale
    return np.block([[x.T @ x / scale / scale.T, across], [across.T, nuisance.T @ nuisance]])


def _moment(design: Design, block: slice, outputs: FloatArray) -> FloatArray:
    """(P, m) products of the same columns with the outputs."""
    scaled = design.columns[block].T @ outputs / design.scale[:, None]
    return np.vstack([scaled, design.nuisance[block].T @ outputs])


def _path(lasso: GroupLasso, moment: FloatArray, energy: float, most: int) -> list[tuple[int, ...]]:
    """Different sets of inputs along the path, the empty one first."""
    found: list[tuple[int, ...]] = [()]
    for solution in lasso.path(moment, energy, _PENALTIES * lasso.largest(moment), _GAP):
        if len(solution.active) > most:
            # The strongest ones are still a proposal; further down the path there are only more.
            strength = [np.linalg.norm(part) for part in solution.coefficients]
            found.append(tuple(sorted(int(i) for i in np.argsort(strength, kind="stable")[::-1][:most])))
            break
        found.append(solution.active)
    return list(dict.fromkeys(found))
