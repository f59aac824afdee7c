"""Choice of inputs and pole: Group-LASSO paths propose, single steps go on while the criterion falls. Deterministic.

The path alone adds inputs in clumps, and its bias favours strong wrong inputs over weak right ones; single steps alone
begin from nothing. Each pole is searched by itself, because the way from one pole's best set to another's may lead
uphill.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, qr

from talc.frame import FloatArray
from talc.group_lasso import GroupLasso
from talc.output_error import Design

_PENALTIES = np.geomspace(0.6, 2e-3, 10)
"""Points of the path, relative to the smallest penalty that leaves no input."""
_GAP = 1e-3
_ITERATIONS = 300

Criterion = Callable[[FloatArray, int, int], float]
"""Cost of a residual (n,) in scaled units, the sum of orders, the number of inputs."""


class PoleProblem:
    """One pole's regression: nuisance projected out, columns of unit length, one Gram matrix for all outputs.

    Parameters
    ----------
    design: filtered inputs
    ridge: added to the Gram matrix' diagonal of 1
    """

    def __init__(self, design: Design, ridge: float) -> None:
        self.design, self._ridge = design, ridge
        self._q: FloatArray = np.asarray(qr(design.nuisance, mode="economic")[0], dtype=np.float64)
        projected = design.columns - self._q @ (self._q.T @ design.columns)
        self._x: FloatArray = projected / np.maximum(np.linalg.norm(projected, axis=0), 1e-12)
        self._gram: FloatArray = np.asarray(self._x.T @ self._x, dtype=np.float64)

    @cached_property
    def lasso(self) -> GroupLasso:
        """The path solver on this Gram matrix."""
        return GroupLasso(self._gram, self.design.lags)

    def free_of_nuisance(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) what the nuisance leaves of y, and (p,) its products with the columns."""
        rest = y - self._q @ (self._q.T @ y)
        return rest, np.asarray(self._x.T @ rest, dtype=np.float64)

    def residual(self, inputs: tuple[int, ...], rest: FloatArray, moment: FloatArray) -> FloatArray:
        """(n,) residual of the least-squares fit on some inputs."""
        if not inputs:
            return rest
        lags = self.design.lags
        picked = np.array([s * lags + j for s in inputs for j in range(lags)])
        normal = self._gram[np.ix_(picked, picked)] + self._ridge * np.eye(picked.size)
        theta = cho_solve(cho_factor(normal, check_finite=False), moment[picked], check_finite=False)
        return np.asarray(rest - self._x[:, picked] @ theta, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Choice:
    """What a search found."""

    criterion: float
    problem: PoleProblem
    inputs: tuple[int, ...]
    """Positions among the offered inputs, ascending."""


def search(problem: PoleProblem, y: FloatArray, most: int, offered: int, criterion: Criterion) -> Choice:
    """The best set of at most `most` of the `offered` inputs that the path and single steps from it lead to."""
    rest, moment = problem.free_of_nuisance(y)
    known: dict[tuple[int, ...], float] = {}

    def cost(inputs: tuple[int, ...]) -> float:
        if inputs not in known:
            orders = (problem.design.pole > 0.0) + len(inputs) * (problem.design.lags - 1)
            known[inputs] = criterion(problem.residual(inputs, rest, moment), orders, len(inputs))
        return known[inputs]

    best = min(_path(problem.lasso, rest, moment, most), key=cost)
    while True:
        better = min(_neighbours(best, most, offered), key=cost)
        if cost(better) >= cost(best):
            return Choice(cost(best), problem, best)
        best = better


def evaluate(problem: PoleProblem, y: FloatArray, inputs: tuple[int, ...], criterion: Criterion) -> Choice:
    """A given set of inputs at this pole."""
    rest, moment = problem.free_of_nuisance(y)
    orders = (problem.design.pole > 0.0) + len(inputs) * (problem.design.lags - 1)
    return Choice(criterion(problem.residual(inputs, rest, moment), orders, len(inputs)), problem, inputs)


def _path(lasso: GroupLasso, rest: FloatArray, moment: FloatArray, most: int) -> list[tuple[int, ...]]:
    """Different sets of inputs along the path, the empty one first."""
    top, energy = lasso.largest(moment), float(rest @ rest)
    found: list[tuple[int, ...]] = [()]
    start = None
    for share in _PENALTIES:
        solution = lasso.solve(moment, energy, float(share) * top, start, _GAP, _ITERATIONS)
        start = solution.coefficients
        if len(solution.active) > most:
            # The strongest ones still are a proposal; further down the path there are only more.
            strength = np.linalg.norm(solution.coefficients, axis=1)
            found.append(tuple(sorted(int(i) for i in np.argsort(-strength, kind="stable")[:most])))
            break
        found.append(solution.active)
    return list(dict.fromkeys(found))


def _neighbours(inputs: tuple[int, ...], most: int, offered: int) -> Iterator[tuple[int, ...]]:
    """One input less, one more, one exchanged; the set itself last, so that there always is one."""
    others = [i for i in range(offered) if i not in inputs]
    fewer = [tuple(i for i in inputs if i != out) for out in inputs]
    yield from fewer
    if len(inputs) < most:
        yield from (tuple(sorted((*inputs, more))) for more in others)
    yield from (tuple(sorted((*kept, more))) for kept in fewer for more in others)
    yield inputs
