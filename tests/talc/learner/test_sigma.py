"""The uncertainty follows how far measurements were from their predictions."""

import numpy as np

from talc.indicators import TWO_SIDED_95
from talc.learner.learner import RowLearner

NOISE, VALID = np.full(1, 0.5), np.ones(2, dtype=np.bool_)


def judged(walk_um: float) -> tuple[float, float]:
    """Share of the unmeasured rows whose 95 % interval holds the truth, and the mean sigma, of an error that follows an
    input and walks by this much in each step; measured each half hour."""
    draw, learner, level = np.random.default_rng(1), RowLearner(2, 300.0, NOISE), 0.0
    inside, sigma = [], []
    for k in range(480):
        swings = np.array([3.0 * np.sin(k / 40.0), 2.0 * np.sin(k / 25.0)])
        level += draw.normal(0.0, walk_um)
        truth = 2.0 * swings[0] + level
        learner.advance(20.0 + swings, VALID, 0)
        if k % 6 == 0:
            learner.learn(np.array([truth + draw.normal(0.0, 0.5)]), NOISE)
        elif k > 60:
            found = learner.estimate()
            inside.append(abs(truth - found.value[0]) <= TWO_SIDED_95 * found.sigma[0])
            sigma.append(float(found.sigma[0]))
    return float(np.mean(inside)), float(np.mean(sigma))


def test_intervals_of_a_machine_that_walks_more_than_assumed_widen_until_they_hold() -> None:
    (_, calm), (held, restless) = judged(0.0), judged(0.6)
    assert held > 0.88
    assert calm < 0.5 * restless
