"""The search against exhaustive enumeration with NumPy's least squares."""

from itertools import combinations, product

import numpy as np
import pytest
from numpy.typing import NDArray

from talc.papers.output_error import Design, fit
from talc.papers.search import BLOCKS, RIDGE, Candidates
from tests.benches.thermal_series import series

Array = NDArray[np.float64]


def designs(u: Array, lags: int = 2) -> list[Design]:
    rows = np.ones(len(u), dtype=np.bool_)
    return [
        Design.make((u - u.mean(0)) / u.std(0), poles, lags, rows) for poles in ((), (0.88,), (0.95,), (0.88, 0.98))
    ]


def candidates(offered: list[Design], y: Array, inputs: int) -> Candidates:
    by_poles = {design.poles: design for design in offered}
    return Candidates(list(by_poles), by_poles.__getitem__, y[:, None], inputs)


def cost(design: Design, coefficients: tuple[int, ...], y: Array) -> float:
    """A BIC of the residuals on blocks left out, by refitting rows."""
    unseen = fit(design, coefficients, y, RIDGE, BLOCKS).unseen
    terms = len(design.poles) + sum(coefficients)
    return float(unseen.size * np.log(np.mean(unseen**2)) + np.log(len(y)) * terms)


def test_the_kernel_s_cost_is_that_of_refitted_rows() -> None:
    s = series(288, seed=2, sensors=12)
    y = (s.measured[:, 2] - s.measured[:, 2].mean()) / s.measured[:, 2].std()
    offered = designs(s.inputs)
    choice = candidates(offered, y, 12).choose(0, 6)
    design = next(d for d in offered if d.poles == choice.poles)
    assert choice.criterion == pytest.approx(cost(design, choice.coefficients, y), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_no_set_of_up_to_three_inputs_is_better(seed: int) -> None:
    s = series(240, seed=seed, sensors=12)
    u, y = s.inputs[:, :5], s.measured[:, seed % 2]  # errors 0 and 1 answer inputs 0, 3 and 1, 4
    y = (y - y.mean()) / y.std()
    offered = designs(u)
    choice = candidates(offered, y, 5).choose(0, 3)
    best = np.inf
    for design in offered:
        for count in range(4):
            for chosen in combinations(range(5), count):
                for orders in product((1, 2), repeat=count):
                    coefficients = [0] * 5
                    for s_, order in zip(chosen, orders, strict=True):
                        coefficients[s_] = order
                    best = min(best, cost(design, tuple(coefficients), y))
    assert choice.criterion == pytest.approx(best, rel=1e-6)


def test_permuting_inputs_permutes_the_answer_and_units_change_nothing() -> None:
    s = series(288, seed=9)
    y = (s.measured[:, 0] - s.measured[:, 0].mean()) / s.measured[:, 0].std()
    order = np.random.default_rng(0).permutation(12)
    plain = candidates(designs(s.inputs), y, 12).choose(0, 6)
    turned = candidates(designs(s.inputs[:, order] * 1.8 + 32.0), y, 12).choose(0, 6)
    assert turned.coefficients == tuple(plain.coefficients[i] for i in order)
    assert turned.poles == plain.poles


def test_given_inputs_are_kept_and_only_poles_chosen() -> None:
    s = series(288, seed=4)
    y = (s.measured[:, 1] - s.measured[:, 1].mean()) / s.measured[:, 1].std()
    choice = candidates(designs(s.inputs), y, 12).choose(0, 6, fixed=(2, 7))
    assert [i for i, count in enumerate(choice.coefficients) if count] == [2, 7]


def test_constant_and_duplicate_inputs_do_no_harm() -> None:
    s = series(288, seed=4)
    y = (s.measured[:, 1] - s.measured[:, 1].mean()) / s.measured[:, 1].std()
    u = np.column_stack([s.inputs, s.inputs[:, 1]])
    rows = np.ones(len(u), dtype=np.bool_)
    scaled = np.column_stack([(u - u.mean(0)) / u.std(0), np.zeros(len(u))])
    choice = candidates([Design.make(scaled, (0.95,), 2, rows)], y, 14).choose(0, 6)
    assert choice.coefficients[13] == 0
    plain = candidates([Design.make(scaled[:, :12], (0.95,), 2, rows)], y, 12).choose(0, 6)
    assert choice.criterion == pytest.approx(plain.criterion, rel=0.01)


def test_an_irrelevant_input_does_not_change_the_set() -> None:
    s = series(400, seed=11)
    y = (s.measured[:, 3] - s.measured[:, 3].mean()) / s.measured[:, 3].std()
    noise = np.random.default_rng(1).normal(size=(400, 1))
    plain = candidates(designs(s.inputs), y, 12).choose(0, 6)
    more = candidates(designs(np.hstack([s.inputs, noise])), y, 13).choose(0, 6)
    assert more.coefficients == (*plain.coefficients, 0)
