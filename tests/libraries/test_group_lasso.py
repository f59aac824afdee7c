"""The exact Group-LASSO against an interior-point solver, the reference ADMM and the optimality conditions."""

from collections.abc import Sequence
from itertools import pairwise

import clarabel
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.admm import admm, duality_gap
from simulators.cases import SEASONS, random_axes
from simulators.plant import Plant, load_machine, record_drive
from talc.papers.group_lasso import GroupLasso

Array = NDArray[np.float64]


def conic(x: Array, y: Array, sizes: Sequence[int], penalty: float) -> Array:
    """The same problem as a second-order cone program over [t, residual bound, group bounds], on the raw design."""
    (n, p), g = x.shape, len(sizes)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    # min s'1_w + r'r with r = y - X t: variables t, r, s.
    quadratic = sparse.block_diag([sparse.csc_matrix((p, p)), 2.0 * sparse.eye(n), sparse.csc_matrix((g, g))])
    linear = np.concatenate([np.zeros(p + n), penalty * np.sqrt(sizes)])
    rows = [sparse.hstack([sparse.csc_matrix(x), sparse.eye(n), sparse.csc_matrix((n, g))])]
    cones: list[object] = [clarabel.ZeroConeT(n)]
    for s, (a, b) in enumerate(pairwise(starts)):
        block = sparse.lil_matrix((1 + b - a, p + n + g))
        block[0, p + n + s] = -1.0
        for i in range(b - a):
            block[1 + i, a + i] = -1.0
        rows.append(block)
        cones.append(clarabel.SecondOrderConeT(int(1 + b - a)))
    right = np.concatenate([y, np.zeros(sum(r.shape[0] for r in rows[1:]))])
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = 1e-12
    matrix = sparse.csc_matrix(sparse.vstack(rows))
    answer = clarabel.DefaultSolver(quadratic.tocsc(), linear, matrix, right, cones, options).solve()
    return np.array(answer.x[:p])


def raw_gap(x: Array, y: Array, sizes: Sequence[int], penalty: float, theta: Array) -> float:
    """Relative duality gap from the design itself, without any Gram matrix."""
    residual = y - x @ theta
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    norms = np.sqrt(np.add.reduceat(theta**2, starts))
    primal = float(residual @ residual) + penalty * float(np.sqrt(sizes) @ norms)
    worst = (2.0 * np.sqrt(np.add.reduceat((x.T @ residual) ** 2, starts)) / np.sqrt(sizes)).max()
    point = min(1.0, penalty / worst) * residual
    return float((primal - (2.0 * point @ y - point @ point)) / primal)


def thermal(seed: int, lags: int, sensors: int) -> tuple[Array, Array]:
    """Lagged temperatures of the simulated machine, 0.1 K steps, and EX0C with 1 µm of noise; z-scored."""
    plant = Plant(load_machine(), SEASONS["spring"], seed)
    series = record_drive(plant, random_axes(seed, 300))
    u = np.round(series.inputs[:, :sensors], 1)
    u = (u - u.mean(0)) / np.maximum(u.std(0), 1e-9)
    y = series.errors[:, 2] + np.random.default_rng(seed).normal(0, 1.0, 300)
    rows = np.arange(lags, 300)
    x = np.column_stack([u[rows - j, s] for s in range(sensors) for j in range(lags)])
    return x - x.mean(0), (y - y.mean())[rows] / y.std()


def solve(x: Array, y: Array, sizes: Sequence[int], penalty: float) -> tuple[Array, float]:
    solution = GroupLasso(x.T @ x, sizes).solve(x.T @ y, float(y @ y), penalty, tolerance=1e-10)
    return np.concatenate(solution.coefficients), solution.gap


@pytest.mark.parametrize("share", [0.5, 0.1, 0.01])
def test_coefficients_are_those_of_an_interior_point_solver(share: float) -> None:
    draw = np.random.default_rng(2)
    sizes = (3, 1, 4, 2, 3)
    x = draw.normal(size=(60, 13)) @ (np.eye(13) + 0.9 * np.ones((13, 13)))
    y = x[:, 1] - 2.0 * x[:, 5] + draw.normal(size=60)
    penalty = share * GroupLasso(x.T @ x, sizes).largest(x.T @ y)
    theta, gap = solve(x, y, sizes, penalty)
    assert gap <= 1e-10
    np.testing.assert_allclose(theta, conic(x, y, sizes, penalty), atol=1e-5)


@pytest.mark.parametrize("share", [0.3, 0.03, 0.003])
def test_ill_conditioned_temperatures_are_solved_to_the_true_gap(share: float) -> None:
    x, y = thermal(seed=1, lags=4, sensors=12)
    sizes = (4,) * 12
    assert np.linalg.cond(x.T @ x) > 1e4
    penalty = share * GroupLasso(x.T @ x, sizes).largest(x.T @ y)
    theta, _ = solve(x, y, sizes, penalty)
    assert raw_gap(x, y, sizes, penalty, theta) <= 1e-8
    # The interior point stops at a gap of up to 4e-9 here (ours: 1e-14), which leaves that much in its coefficients.
    np.testing.assert_allclose(theta, conic(x, y, sizes, penalty), atol=3e-5)


def test_the_reference_admm_agrees() -> None:
    x, y = thermal(seed=2, lags=2, sensors=8)
    sizes = (2,) * 8
    gram, moment, energy = x.T @ x, x.T @ y, float(y @ y)
    penalty = 0.05 * GroupLasso(gram, sizes).largest(moment)
    slow, gap, iterations = admm(gram, moment, energy, sizes, penalty)
    assert gap <= 1e-8
    assert iterations > 25
    np.testing.assert_allclose(solve(x, y, sizes, penalty)[0], slow, atol=1e-4)
    assert duality_gap(gram, moment, energy, sizes, penalty, slow) == pytest.approx(
        raw_gap(x, y, sizes, penalty, slow), abs=1e-9
    )


def test_above_the_largest_penalty_nothing_is_left() -> None:
    draw = np.random.default_rng(3)
    x, y = draw.normal(size=(50, 6)), draw.normal(size=50)
    solver = GroupLasso(x.T @ x, (2, 2, 2))
    top = solver.largest(x.T @ y)
    assert solver.solve(x.T @ y, float(y @ y), 1.0001 * top).active == ()
    assert solver.solve(x.T @ y, float(y @ y), 0.98 * top).active != ()


def test_the_way_there_does_not_matter() -> None:
    x, y = thermal(seed=3, lags=3, sensors=10)
    solver, moment, energy = GroupLasso(x.T @ x, (3,) * 10), x.T @ y, float(y @ y)
    penalties = np.geomspace(0.5, 1e-3, 8) * solver.largest(moment)
    warm = list(solver.path(moment, energy, penalties, 1e-10))[-1]
    cold = solver.solve(moment, energy, float(penalties[-1]), tolerance=1e-10)
    np.testing.assert_allclose(np.concatenate(warm.coefficients), np.concatenate(cold.coefficients), atol=1e-6)


def test_permuting_groups_permutes_the_answer() -> None:
    x, y = thermal(seed=4, lags=2, sensors=6)
    order = [4, 0, 5, 2, 1, 3]
    turned = np.column_stack([x[:, 2 * s : 2 * s + 2] for s in order])
    plain, permuted = solve(x, y, (2,) * 6, 3.0)[0], solve(turned, y, (2,) * 6, 3.0)[0]
    np.testing.assert_allclose(permuted.reshape(6, 2), plain.reshape(6, 2)[order], atol=1e-7)


def test_duplicates_constants_and_no_rows_are_survived() -> None:
    draw = np.random.default_rng(5)
    column = draw.normal(size=(40, 2))
    x = np.column_stack([column, column, np.zeros((40, 2))])
    y = column @ np.array([1.0, -1.0])
    theta, gap = solve(x, y, (2, 2, 2), 0.1)
    assert gap <= 1e-8
    assert not theta[4:].any()
    nothing, gap = solve(np.zeros((0, 4)), np.zeros(0), (2, 2), 1.0)
    assert not nothing.any()
    assert gap == 0.0
    one_row, gap = solve(np.array([[1.0, 2.0, 3.0, 4.0]]), np.array([5.0]), (2, 2), 0.5)
    assert gap <= 1e-8
    assert np.isfinite(one_row).all()


@pytest.mark.parametrize(
    ("gram", "sizes", "message"),
    [
        (np.eye(3), (2, 2), "gram has shape"),
        (np.full((2, 2), np.nan), (2,), "not finite"),
        (np.eye(2), (0, 2), "sizes"),
        (np.eye(65), (65,), "at most 64"),
    ],
)
def test_bad_problems_are_refused(gram: Array, sizes: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GroupLasso(gram, sizes)


def test_bad_outputs_and_penalties_are_refused() -> None:
    solver = GroupLasso(np.eye(2), (1, 1))
    with pytest.raises(ValueError, match="moment has shape"):
        solver.solve(np.zeros(3), 1.0, 1.0)
    with pytest.raises(ValueError, match="penalty = -1"):
        solver.solve(np.zeros(2), 1.0, -1.0)
    with pytest.raises(ValueError, match="not finite"):
        solver.solve(np.array([np.nan, 0.0]), 1.0, 1.0)
    other = GroupLasso(np.eye(1), (1,)).solve(np.ones(1), 1.0, 0.1)
    with pytest.raises(ValueError, match="start has 1 coefficients: expected 2"):
        solver.solve(np.zeros(2), 1.0, 1.0, other)
