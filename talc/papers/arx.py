"""ARX, FIR and static models by weighted least squares (Z22 eq. 2 and 5), guarded and refined.

The weights are 0 and 1: a row counts if its output was measured and the outputs before it are known, measured or
estimated (`Window.past`). Static and FIR models are the case na = 0. One-step least squares shrinks the poles when
outputs are noisy; starting there, `refine` fits the free run instead. For irregular or noisy measurements
talc.papers.output_error is the better method.

SciPy and OSQP are imported where they are used: the default route needs neither, and on a small computer this saves
half a second at start and tens of megabytes.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from talc.frame import BoolArray, FloatArray
from talc.papers.window import Coefficients, Structure, Window

_FAR = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquares:
    """Coefficients with their uncertainty, in scaled units."""

    parameters: Coefficients
    std: FloatArray
    """(1 + na + sum of nb_s + 1,) standard errors: intercept, a, b input by input; NaN where the rows do not determine
    them."""
    freedom: int
    """Rows minus coefficients."""
    residual: FloatArray
    """(n,) one-step residuals over the rows of the fit."""

    def interval(self, confidence: float = 0.95) -> FloatArray:
        """(p, 2) confidence interval of each coefficient (Student's t), in the order of `std`."""
        from scipy.stats import t as student

        p = self.parameters
        values = np.concatenate([[p.intercept], p.a, *p.b])
        reach = student.ppf(0.5 + confidence / 2.0, max(self.freedom, 1)) * self.std
        return np.column_stack([values - reach, values + reach])


class Regression:
    """One-step rows of a window at the largest orders, so that the rows used do not depend on a candidate's orders.

    Parameters
    ----------
    window: one error's training rows
    na, nb: largest orders
    """

    def __init__(self, window: Window, na: int, nb: int) -> None:
        if na < 0 or nb < 0:
            raise ValueError(f"na = {na}, nb = {nb}: expected 0 or more")
        steps = np.arange(max(na, nb), len(window.y))
        past = np.column_stack([np.ones(steps.size), *(window.past[steps - i] for i in range(1, na + 1))])
        use: BoolArray = np.isfinite(window.y[steps]) & np.isfinite(past).all(axis=1)
        self.window, self.na, self.nb = window, na, nb
        self.steps = steps[use]
        self.own: FloatArray = past[use]
        """(n, 1 + na): 1, y[k-1], ..., y[k-na]"""
        self.y: FloatArray = window.y[self.steps]

    def columns(self, structure: Structure) -> FloatArray:
        """(n, 1 + na + sum of nb_s + 1) regressors of one structure. ValueError: orders above the largest."""
        if structure.na > self.na or max(structure.nb, default=0) > self.nb:
            raise ValueError(f"{structure}: expected na <= {self.na} and every nb <= {self.nb}")
        u, k = self.window.u, self.steps
        lagged = [u[k - j, s] for s, nb in zip(structure.inputs, structure.nb, strict=True) for j in range(nb + 1)]
        return np.column_stack([self.own[:, : 1 + structure.na], *lagged])


def least_squares_fit(regression: Regression, structure: Structure) -> LeastSquares:
    """Weighted least squares by QR with column pivoting on columns of unit length.

    ValueError: fewer rows than coefficients. Columns that the others explain get 0, with NaN as standard error.
    """
    from scipy.linalg import qr, solve_triangular

    x = _enough(regression.columns(structure))
    n, p = x.shape
    scale = np.maximum(np.linalg.norm(x, axis=0), 1e-300)
    q, r, order = qr(x / scale, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > 1e-12 * abs(r[0, 0])).sum())
    theta, std = np.zeros(p), np.full(p, np.nan)
    top = r[:rank, :rank]
    theta[order[:rank]] = solve_triangular(top, (q.T @ regression.y)[:rank])
    residual = regression.y - (x / scale) @ theta
    inverse = solve_triangular(top, np.eye(rank))
    variance = float(residual @ residual) / max(n - rank, 1)
    std[order[:rank]] = np.sqrt((inverse**2).sum(axis=1) * variance)
    return LeastSquares(_parameters(theta / scale, structure), std / scale, n - rank, residual)


def guarded_fit(
    regression: Regression, structure: Structure, *, max_pole: float = 0.98, max_gain: float = 10.0
) -> Coefficients:
    """Least squares under linear constraints that keep the model stable and its static gains plausible (OSQP).

    sum |phi_i| <= max_pole is sufficient for all poles inside that radius; |sum_j b_sj| <= max_gain (1 - sum phi_i)
    bounds every static gain, scaled units. Solved on y[k-1], its differences, u and its differences, each of unit RMS:
    on the raw regressors (condition 2e6) the solver gives up.
    ValueError: fewer rows than coefficients; RuntimeError: the solver did not solve it.
    """
    import osqp
    from scipy import sparse

    x = _enough(regression.columns(structure))
    p, na = x.shape[1], structure.na
    groups = [[0], list(range(1, 1 + na))]
    for nb in structure.nb:
        begin = groups[-1][-1] + 1 if groups[-1] else 1
        groups.append(list(range(begin, begin + nb + 1)))
    to_levels = np.zeros((p, p))
    for group in groups:
        for j, column in enumerate(group):
            to_levels[column, column] = 1.0 if j == 0 else -1.0
            if j:
                to_levels[group[j - 1], column] = 1.0
    z = x @ to_levels
    scale = np.maximum(np.sqrt(np.mean(z**2, axis=0)), 1e-12)
    rows, bounds = [], []
    for signs in product((-1.0, 1.0), repeat=na):
        if na:
            rows.append(np.concatenate([[0.0], signs, np.zeros(p - 1 - na)]))
            bounds.append(max_pole)
    for group in groups[2:]:
        for sign in (-1.0, 1.0):
            row = np.zeros(p)
            row[group] = sign
            row[1 : 1 + na] = max_gain
            rows.append(row)
            bounds.append(max_gain)
    constraints = np.array(rows).reshape(-1, p) @ to_levels / scale
    scaled = z / scale
    problem = osqp.OSQP()
    problem.setup(
        sparse.csc_matrix(scaled.T @ scaled / len(z) + 1e-9 * np.eye(p)),
        -scaled.T @ regression.y / len(z),
        sparse.csc_matrix(constraints),
        np.full(len(bounds), -np.inf),
        np.array(bounds),
        verbose=False,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=100_000,
    )
    answer = problem.solve(raise_error=False)
    if answer.info.status != "solved":
        raise RuntimeError(f"guarded fit of {structure}: OSQP reports {answer.info.status!r}")
    theta = to_levels @ (np.asarray(answer.x) / scale)
    return _parameters(theta, structure)


def refine(window: Window, structure: Structure, start: Coefficients, *, max_pole: float = 0.999) -> Coefficients:
    """Fits the free run, from `start` on (simulation error, Levenberg-Marquardt with filtered regressors as gradient).

    Every measured row counts, whatever preceded it. Returns `start` if the result is not better or has a pole of
    `max_pole` or more in magnitude.
    """
    from scipy.optimize import least_squares
    from scipy.signal import lfilter

    begin = max(structure.na, max(structure.nb, default=0))
    steps = np.arange(begin, len(window.y))
    measured = np.isfinite(window.y[steps])
    known = window.past[np.isfinite(window.past)]
    first = np.full(structure.na, known[0] if known.size else 0.0)
    u = window.u
    lagged = [u[steps - j, s] for s, nb in zip(structure.inputs, structure.nb, strict=True) for j in range(nb + 1)]
    drive = np.column_stack([np.ones(steps.size), *lagged])

    def run(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        denominator = np.concatenate([[1.0], theta[: structure.na]])
        history = np.array([-float(denominator[i + 1 :] @ first[: structure.na - i]) for i in range(structure.na)])
        y = lfilter([1.0], denominator, drive @ theta[structure.na :], zi=history)[0]
        return np.clip(np.nan_to_num(y, nan=_FAR), -_FAR, _FAR), denominator

    def residual(theta: FloatArray) -> FloatArray:
        return np.asarray((run(theta)[0] - window.y[steps])[measured], dtype=np.float64)

    def gradient(theta: FloatArray) -> FloatArray:
        y, denominator = run(theta)
        before = np.concatenate([first, y])
        past = [-before[structure.na - i : len(before) - i] for i in range(1, structure.na + 1)]
        columns = lfilter([1.0], denominator, np.column_stack([*past, drive]), axis=0)
        bounded: FloatArray = np.clip(np.nan_to_num(columns[measured], nan=_FAR), -_FAR, _FAR)
        return bounded

    theta = np.concatenate([start.a, [start.intercept], *start.b])
    found = least_squares(residual, theta, gradient, method="lm" if measured.sum() >= theta.size else "trf")
    stable = bool(np.all(np.abs(np.roots(np.concatenate([[1.0], found.x[: structure.na]]))) < max_pole))
    if not stable or 2.0 * found.cost >= float(residual(theta) @ residual(theta)):
        return start
    reordered = np.concatenate([[found.x[structure.na]], -found.x[: structure.na], found.x[structure.na + 1 :]])
    return _parameters(reordered, structure)


def simulate(window: Window, structure: Structure, parameters: Coefficients) -> FloatArray:
    """(T,) free run in scaled units from the first measured outputs; NaN in the rows before the largest order."""
    begin, drive, a = _driven(window, structure, parameters)
    known = window.past[np.isfinite(window.past)]
    run = np.full(len(window.y), np.nan)
    history = [float(known[0]) if known.size else 0.0] * structure.na
    for k in range(begin, len(run)):
        y = _next(drive[k], a, history)
        run[k] = y
        history = [y, *history[:-1]] if history else history
    return run


def followed(window: Window, structure: Structure, parameters: Coefficients) -> FloatArray:
    """(T,) the output as a running control knows it: measured, else the model's own estimate then (Z22 eq. 2).

    A measurement shifts the model's whole output history by its residual. NaN before the first measurement and in the
    rows before the largest order. In scaled units.
    """
    begin, drive, a = _driven(window, structure, parameters)
    known = window.y.copy()
    measured = np.flatnonzero(np.isfinite(known))
    first = int(measured[0]) if measured.size else len(known)
    history = [float(known[first])] * structure.na if measured.size else []
    for k in range(max(begin, first), len(known)):
        y = _next(drive[k], a, history)
        shift = float(known[k]) - y if np.isfinite(known[k]) else 0.0
        known[k] = y + shift
        history = [h + shift for h in (y, *history[:-1])] if history else history
    return known


def _driven(window: Window, structure: Structure, parameters: Coefficients) -> tuple[int, list[float], list[float]]:
    """First row that has all its inputs, what intercept and inputs contribute in each row, and AR coefficients."""
    begin = max(structure.na, max(structure.nb, default=0))
    steps = np.arange(begin, len(window.y))
    drive = np.zeros(len(window.y))
    drive[begin:] = parameters.intercept
    for s, b in zip(structure.inputs, parameters.b, strict=True):
        for j, coefficient in enumerate(b):
            drive[begin:] += coefficient * window.u[steps - j, s]
    return begin, drive.tolist(), parameters.a.tolist()


def _next(drive: float, a: list[float], history: list[float]) -> float:
    y = drive - sum(c * h for c, h in zip(a, history, strict=True))
    return min(max(y, -_FAR), _FAR)


def _enough(x: FloatArray) -> FloatArray:
    """The columns, if there are enough rows for them."""
    n, p = x.shape
    if n < p:
        raise ValueError(f"{n} rows for {p} coefficients: measure more, or lower the orders")
    return x


def _parameters(theta: FloatArray, structure: Structure) -> Coefficients:
    parts = np.split(theta[1 + structure.na :], np.cumsum([nb + 1 for nb in structure.nb])[:-1])
    b = tuple(parts) if structure.inputs else ()
    return Coefficients(-theta[1 : 1 + structure.na], b, float(theta[0]))
