"""One Group-LASSO: 30 temperatures with nb = 5 over a day, twelve penalties, three errors, against other solvers."""

import statistics
import time
import warnings
from collections.abc import Callable
from functools import partial

import celer
import clarabel
import numpy as np
import skglm
from scipy import sparse

from benchmarks.admm import admm
from benchmarks.data import machine_days
from benchmarks.rows import BenchRow, median_s
from talc.frame import FloatArray
from talc.papers.group_lasso import GroupLasso

_LAGS, _INPUTS = 6, 30
_TIGHT = 1e-11
_SHARES = np.geomspace(0.5, 1e-4, 12)


def _problems() -> list[tuple[FloatArray, FloatArray, float]]:
    """Raw designs with intercept and y[k-1] projected out, outputs, penalties."""
    m = machine_days("day", 3, 24)
    u = m.inputs[:, m.inputs.std(axis=0) > 1e-6][:, :_INPUTS]
    u = (u - u.mean(axis=0)) / u.std(axis=0)
    k = np.arange(_LAGS - 1, len(u))
    columns = np.column_stack([u[k - j, s] for s in range(_INPUTS) for j in range(_LAGS)])
    problems = []
    for e in (1, 2, 6):
        y = (m.measured[:, e] - m.measured[:, e].mean()) / m.measured[:, e].std()
        q = np.linalg.qr(np.column_stack([np.ones(k.size), y[k - 1]]))[0]
        x, target = columns - q @ (q.T @ columns), y[k] - q @ (q.T @ y[k])
        top = GroupLasso(x.T @ x, [_LAGS] * _INPUTS).largest(x.T @ target)
        problems += [(x, target, float(share * top)) for share in _SHARES]
    return problems


def _gap(x: FloatArray, y: FloatArray, penalty: float, theta: FloatArray) -> float:
    """True relative duality gap, from the raw design."""
    residual = y - x @ theta
    norms = np.linalg.norm(theta.reshape(_INPUTS, _LAGS), axis=1)
    primal = float(residual @ residual + penalty * np.sqrt(_LAGS) * norms.sum())
    worst = 2.0 * np.linalg.norm((x.T @ residual).reshape(_INPUTS, _LAGS), axis=1).max() / np.sqrt(_LAGS)
    point = min(1.0, penalty / worst) * residual
    return (primal - float(2.0 * point @ y - point @ point)) / primal


def _ours(x: FloatArray, y: FloatArray, penalty: float, tolerance: float = 1e-8) -> FloatArray:
    solver = GroupLasso(x.T @ x, [_LAGS] * _INPUTS)
    solution = solver.solve(x.T @ y, float(y @ y), penalty, tolerance=tolerance)
    return np.concatenate(solution.coefficients)


def _celer(x: FloatArray, y: FloatArray, penalty: float) -> FloatArray:
    alpha = penalty * np.sqrt(_LAGS) / (2 * len(y))
    model = celer.GroupLasso(groups=_LAGS, alpha=alpha, fit_intercept=False, tol=1e-10, max_iter=100, max_epochs=5_000)
    return np.asarray(model.fit(x, y).coef_)


def _skglm(x: FloatArray, y: FloatArray, penalty: float) -> FloatArray:
    alpha = penalty * np.sqrt(_LAGS) / (2 * len(y))
    model = skglm.GroupLasso(groups=_LAGS, alpha=alpha, fit_intercept=False, tol=1e-10, max_iter=100, max_epochs=5_000)
    return np.asarray(model.fit(x, y).coef_)


def _clarabel(x: FloatArray, y: FloatArray, penalty: float) -> FloatArray:
    """The cone program on the raw design: variables t, residual, one bound per group."""
    n, p, g = len(y), _INPUTS * _LAGS, _INPUTS
    quadratic = sparse.block_diag([sparse.csc_matrix((p, p)), 2.0 * sparse.eye(n), sparse.csc_matrix((g, g))])
    linear = np.concatenate([np.zeros(p + n), np.full(g, penalty * np.sqrt(_LAGS))])
    rows = [sparse.hstack([sparse.csc_matrix(x), sparse.eye(n), sparse.csc_matrix((n, g))])]
    cones: list[object] = [clarabel.ZeroConeT(n)]
    for s in range(g):
        block = sparse.lil_matrix((1 + _LAGS, p + n + g))
        block[0, p + n + s] = -1.0
        for i in range(_LAGS):
            block[1 + i, s * _LAGS + i] = -1.0
        rows.append(block)
        cones.append(clarabel.SecondOrderConeT(1 + _LAGS))
    right = np.concatenate([y, np.zeros(g * (1 + _LAGS))])
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = 1e-12
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix(quadratic), linear, sparse.csc_matrix(sparse.vstack(rows)), right, cones, options
    ).solve()
    return np.array(answer.x[:p])


def rows() -> list[BenchRow]:
    """Times and true gaps of all solvers on the same problems, and our distance from the interior-point solution."""
    problems = _problems()
    some = problems[1::3]
    ours = [_ours(*problem) for problem in problems]
    solve_s, rounds = [], []
    for x, y, penalty in problems:
        solver, moment, energy = GroupLasso(x.T @ x, [_LAGS] * _INPUTS), x.T @ y, float(y @ y)
        solve_s.append(median_s(partial(solver.solve, moment, energy, penalty), 7))
    for x, y, penalty in some:
        gram, moment, energy = x.T @ x, x.T @ y, float(y @ y)
        work = partial(admm, gram, moment, energy, [_LAGS] * _INPUTS, penalty, limit=20_000)
        rounds.append(median_s(work, 3))
    gap = max(_gap(*problem, theta) for problem, theta in zip(problems, ours, strict=True))
    same = statistics.mean(solve_s[1::3])
    slow = statistics.mean(rounds)
    table = [
        BenchRow(
            "Group-LASSO solve, 30 inputs, nb = 5, mean of 36 problems",
            f"{1e3 * statistics.mean(solve_s):.2f} ms, true gap at most {gap:.0e}",
        ),
        BenchRow("ADMM in NumPy, stopped at that gap", f"{slow / same:.0f} × ours", f"{1e3 * slow:.0f} ms"),
    ]
    whole = statistics.mean(median_s(partial(_ours, *problem), 5) for problem in some)
    peers: dict[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {"celer": _celer, "skglm": _skglm}
    for name, peer in peers.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            peer(*problems[0])  # compiled at first use
            taken, gaps = [], []
            for problem in some:
                start = time.perf_counter()
                theta = peer(*problem)
                taken.append(time.perf_counter() - start)
                gaps.append(_gap(*problem, theta))
        mean = statistics.mean(taken)
        text = f"{1e3 * mean:.0f} ms, gap {statistics.median(gaps):.0e}, at most {max(gaps):.0e}"
        table.append(BenchRow(f"{name}, from the design (ours with the Gram)", f"{mean / whole:.0f} × ours", text))
    # On such designs a gap of 1e-8 leaves more of a coefficient open than 1e-5.
    exact = [_clarabel(*problem) for problem in some]
    loose, tight = (
        max(float(np.abs(_ours(*problem, tolerance) - e).max()) for problem, e in zip(some, exact, strict=True))
        for tolerance in (1e-8, _TIGHT)
    )
    table.append(
        BenchRow(
            f"coefficients against Clarabel, solved to {_TIGHT:.0e}",
            f"{tight:.0e} apart at most",
            f"{loose:.0e} when solved to 1e-8",
        )
    )
    return table
