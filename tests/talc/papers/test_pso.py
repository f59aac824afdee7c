"""The swarm: an independent path judges its best candidate; and the criteria by hand."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.admm import admm
from talc.papers import criteria
from talc.papers.arx import Regression
from talc.papers.pso import Chosen, select_by_swarm
from talc.papers.window import Structure, Window
from tests.benches.thermal_series import series

Array = NDArray[np.float64]


def problem(seed: int, error: int = 0, steps: int = 200) -> Regression:
    s = series(steps, seed=seed)
    y, u = s.measured[:, error], s.inputs
    scaled = (y - y.mean()) / y.std()
    return Regression(Window((u - u.mean(0)) / u.std(0), scaled, scaled.copy(), float(y.std())), 3, 2)


def run_again(regression: Regression, chosen: Chosen) -> Array:
    """Residuals of the best candidate, µm: ADMM for the coefficients, lfilter for the free run."""
    w, na = regression.window, chosen.structure.na
    x = regression.columns(Structure(na, chosen.structure.inputs, chosen.structure.nb))
    own, lagged = x[:, : 1 + na], x[:, 1 + na :]
    q = np.linalg.qr(own)[0]
    left, target = lagged - q @ (q.T @ lagged), regression.y - q @ (q.T @ regression.y)
    gram = left.T @ left + 1e-5 * len(target) * np.eye(left.shape[1])
    sizes = [nb + 1 for nb in chosen.structure.nb]
    theta = admm(gram, left.T @ target, float(target @ target), sizes, chosen.penalty, tolerance=1e-11)[0]
    phi = np.linalg.lstsq(own, regression.y - lagged @ theta, rcond=None)[0]
    begin = max(regression.na, regression.nb)
    drive = np.array(
        [
            phi[0] + sum(t * w.u[k - j, s] for (s, j), t in zip(_places(chosen.structure), theta, strict=True))
            for k in range(begin, len(w.y))
        ]
    )
    past = w.y[begin - np.arange(1, na + 1)]
    state = np.array([float(phi[1 + i :] @ past[: na - i]) for i in range(na)])
    run = lfilter([1.0], [1.0, *-phi[1:]], drive, zi=state)[0]
    return np.asarray((w.y[begin:] - run) * w.y_std)


def judged(criterion: criteria.Criterion, residual: Array, structure: Structure) -> float:
    """The criterion as its source states it."""
    n, squares = len(residual), float(residual @ residual)
    d = structure.na + sum(nb + 1 for nb in structure.nb)
    match criterion:
        case "adapted_bic":
            orders = structure.na + sum(structure.nb)
            return criteria.adapted_bic(residual, orders, len(structure.inputs), 5.0, 0.75)
        case "bic":
            return criteria.bic(residual, d)
        case "aic":  # Akaike 1974
            return n * math.log(squares / n) + 2 * d
        case "mdl":  # Rissanen 1978; Ljung, System Identification, eq. 16.36
            return squares / n * (1 + d * math.log(n) / n)


def _places(structure: Structure) -> list[tuple[int, int]]:
    return [(s, j) for s, nb in zip(structure.inputs, structure.nb, strict=True) for j in range(nb + 1)]


@pytest.mark.parametrize("criterion", criteria.CRITERIA)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_best_candidate_costs_what_the_swarm_says(seed: int, criterion: criteria.Criterion) -> None:
    regression = problem(seed)
    chosen = select_by_swarm(regression, seed=seed, swarm=20, iterations=20, criterion=criterion)
    assert chosen.gap <= 1e-8
    again = judged(criterion, run_again(regression, chosen), chosen.structure)
    assert chosen.criterion == pytest.approx(again, rel=1e-4)


def test_the_same_seed_gives_the_same_choice_and_more_iterations_no_worse_one() -> None:
    regression = problem(4)
    short = select_by_swarm(regression, seed=7, swarm=20, iterations=5)
    assert short == select_by_swarm(regression, seed=7, swarm=20, iterations=5)
    assert select_by_swarm(regression, seed=7, swarm=20, iterations=40).criterion <= short.criterion


def test_what_made_the_record_is_among_the_chosen_inputs() -> None:
    chosen = select_by_swarm(problem(5, error=2, steps=400), seed=1)
    assert {2, 5} <= set(chosen.structure.inputs)


def test_too_few_rows_are_refused() -> None:
    with pytest.raises(ValueError, match="rows: expected at least 2"):
        select_by_swarm(problem(7, steps=4), seed=1)


def test_adapted_bic_by_hand() -> None:
    residual = np.array([1.0, -2.0, 3.0, -4.0])  # sum of squares 30, max 4
    within = criteria.adapted_bic(residual, 5, 2, tolerance=8.0, safety=0.75)
    assert within == pytest.approx(np.log(4) * 9 + 4 * np.log(30))
    beyond = criteria.adapted_bic(residual, 5, 2, tolerance=4.0, safety=0.75)
    assert beyond == pytest.approx(np.log(4) * 9 + 4 * np.log(30) * 4 / 3)
    guarded = criteria.adapted_bic(np.array([0.1, 0.1]), 1, 1, 0.01, 0.75)
    assert guarded == pytest.approx(np.log(2) * 2)
    assert criteria.adapted_bic(np.array([np.inf, 1.0]), 1, 1, 5.0, 0.75) == criteria.WORST


def test_bic_by_hand() -> None:
    residual = np.array([1.0, -2.0, 3.0, -4.0])
    assert criteria.bic(residual, 3) == pytest.approx(4 * math.log(7.5) + 3 * math.log(4))
    assert criteria.bic(np.array([np.nan]), 1) == criteria.WORST
    with pytest.raises(ValueError, match="empty"):
        criteria.bic(np.zeros(0), 1)
