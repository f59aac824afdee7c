"""The substitute for a missing input, against the closed form of a joint normal distribution."""

import numpy as np
import pytest

from talc.learner.features import LagBank
from talc.learner.inputs import InputMemory

COVARIANCE = np.array([[4.0, 3.0, 1.0], [3.0, 5.0, 0.5], [1.0, 0.5, 2.0]])
ALL = np.ones(3, dtype=np.bool_)


def remembered(rows: int) -> InputMemory:
    memory = InputMemory(3, 300.0)
    for row in 20.0 + np.random.default_rng(0).multivariate_normal(np.zeros(3), COVARIANCE, rows):
        memory.fill(row, ALL)
    return memory


def test_a_missing_input_stands_at_its_conditional_mean_with_its_conditional_variance() -> None:
    memory = remembered(4000)
    filled, doubt, _ = memory.fill(np.array([23.0, 0.0, 19.0]), np.array([True, False, True]))
    given, across = COVARIANCE[np.ix_([0, 2], [0, 2])], COVARIANCE[np.ix_([0, 2], [1])][:, 0]
    gain = np.linalg.solve(given, across)
    assert filled[1] == pytest.approx(20.0 + gain @ np.array([3.0, -1.0]), abs=0.15)
    assert doubt is not None
    assert doubt[1, 1] == pytest.approx(COVARIANCE[1, 1] - gain @ across, rel=0.1)
    assert not doubt[0].any()


def test_an_input_that_comes_back_elsewhere_counts_from_there() -> None:
    memory = remembered(2000)
    memory.anchor()
    reference = memory.reference.copy()
    for _ in range(5):
        memory.fill(np.full(3, 20.0), np.array([True, False, True]))
    _, _, moved = memory.fill(np.array([20.0, 45.0, 20.0]), ALL)
    assert moved.tolist() == [False, True, False]
    assert memory.reference[1] - reference[1] == pytest.approx(25.0, abs=0.5)


def test_one_that_comes_back_where_the_others_say_is_the_same_sensor() -> None:
    memory = remembered(2000)
    for _ in range(5):
        memory.fill(np.full(3, 20.0), np.array([True, False, True]))
    assert not memory.fill(np.array([21.0, 22.0, 20.0]), ALL)[2].any()


def test_an_input_that_first_comes_late_counts_from_its_first_value() -> None:
    memory = InputMemory(2, 300.0)
    memory.fill(np.array([20.0, 0.0]), np.array([True, False]))
    memory.anchor()
    memory.fill(np.array([25.0, 30.0]), np.array([True, True]))
    assert memory.reference.tolist() == [20.0, 30.0]


def test_lags_settle_at_what_stands_still_and_a_span_grows_with_what_moves() -> None:
    bank = LagBank(1, (0.0, 900.0), 300.0, 3.0)
    bank.restart(np.array([6.0]))
    bank.advance(np.array([6.0]))
    np.testing.assert_allclose(bank.features(), [2.0, 2.0])
    bank.advance(np.array([9.0]))
    assert bank.features()[1] == pytest.approx(3.0 - np.exp(-1.0 / 3.0))
    assert bank.towards(0.4, np.array([12.0]))[1] == pytest.approx(
        4.0 - (1.0 + np.exp(-1.0 / 3.0)) * np.exp(-0.4 / 3.0)
    )
    factor = bank.widen(np.array([12000.0]))
    bank.advance(np.array([12000.0]))
    assert factor[0] == 4096.0
    assert 0.5 < bank.features()[0] <= 1.0
