"""The processes against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from talc.learner.experts import EXPERTS, UNIT, Expert
from talc.learner.mixture import Mixture
from talc.learner.process import MOST_ROWS, Rows

Array = NDArray[np.float64]

INPUTS, LAGS = 4, 2
FEATURES = INPUTS * LAGS
NOISE = 0.7
REFERENCE = NOISE**2 / 5
"""Variance of the reference's noise."""


def features(count: int, seed: int = 0) -> Array:
    """The first row is the reference."""
    walk = np.cumsum(np.random.default_rng(seed).normal(size=(count, FEATURES)), axis=0) * 0.3
    return np.asarray(walk - walk[0])


def covariance(expert: Expert, x: Array, at: Array, other: Array, at_other: Array) -> Array:
    """Of the errors at rows (T, p) and (S, p), without noise; the smooth part conditioned on 0 at the reference."""

    def smooth(one: Array, two: Array) -> Array:
        apart = np.sum((one[:, None] - two[None]) ** 2, axis=2)
        return np.asarray((expert.smooth * UNIT) ** 2 * np.exp(-apart / (2 * FEATURES)))

    zero, level = np.zeros((1, FEATURES)), np.minimum(at[:, None], at_other[None])
    conditioned = smooth(x, other)
    if expert.smooth:
        conditioned = conditioned - smooth(x, zero) @ smooth(zero, other) / smooth(zero, zero)
    return np.asarray(
        (expert.linear * UNIT) ** 2 / FEATURES * x @ other.T + conditioned + (expert.level * UNIT) ** 2 * level
    )


def posterior(expert: Expert, x: Array, steps: Array, y: Array, at: Array, at_step: float) -> tuple[float, float]:
    """Mean and variance of the error at one row, from one dense normal distribution; by SciPy."""
    steps, at_step = steps - steps[0], at_step - steps[0]
    noise = NOISE**2 + (expert.misfit * UNIT) ** 2
    among = covariance(expert, x, steps, x, steps) + REFERENCE + noise * np.eye(len(y))
    across = covariance(expert, x, steps, at[None], np.array([at_step]))[:, 0]
    own = covariance(expert, at[None], np.array([at_step]), at[None], np.array([at_step]))[0, 0]
    factor = cho_factor(among)
    return float(across @ cho_solve(factor, y)), float(own - across @ cho_solve(factor, across))


def alone(expert: Expert) -> Mixture:
    return Mixture(INPUTS, LAGS, 300.0, (expert,))


def fed(mixture: Mixture, x: Array, steps: Array, y: Array) -> None:
    """y of the first error; the others are not measured."""
    last = steps[0]
    for row, step, value in zip(x, steps, y, strict=True):
        mixture.elapse(int(step - last))
        last = step
        errors = np.full(9, np.nan)
        errors[0] = value
        mixture.learn(row, errors, np.full(9, NOISE), np.zeros(9))


LINEAR, SMOOTH = Expert(1.0, 0.01), Expert(2.0, 0.02, smooth=1.5, misfit=0.05)


@pytest.mark.parametrize("expert", [LINEAR, SMOOTH, Expert(0.5, 0.0, smooth=2.0)])
def test_a_process_is_the_dense_normal_distribution_s_posterior(expert: Expert) -> None:
    count, draw = 40, np.random.default_rng(1)
    x, steps = features(count), np.cumsum(draw.integers(1, 20, count)).astype(float)
    y = x[:, 0] * 0.8 - x[:, 3] ** 2 * 0.5 + draw.normal(0, NOISE, count)
    y[0] = 0.3
    mixture = alone(expert)
    fed(mixture, x, steps, y)
    mixture.elapse(7)
    at = features(30, 5)[-1]
    mean, variance = mixture.predict(at)
    wanted = posterior(expert, x, steps, y, at, steps[-1] + 7)
    centre = float(mixture.believed[0]) * wanted[0]
    assert mean[0] == pytest.approx(centre, rel=1e-7)
    misfit = (expert.misfit * UNIT) ** 2
    assert variance[0] == pytest.approx(wanted[1] + misfit + (wanted[0] - centre) ** 2, rel=1e-7)


def test_a_measurement_narrows_another_prediction_by_their_covariance_squared() -> None:
    """Conditional variance of a joint normal distribution: Var(z | y) = Var(z) - Cov(z, y)² / (Var(y) + noise²)."""
    mixture, x = alone(SMOOTH), features(20)
    fed(mixture, x, np.arange(0.0, 60.0, 3.0), x[:, 0])
    mixture.elapse(5)
    here, others, ahead = features(9, 5)[-1], features(9, 6)[-3:], np.array([0.0, 4.0, 9.0])
    covered = mixture.covariance(here, others, ahead)
    seen = mixture._each(here, 0, reference=True)[1][0, 1]  # noqa: SLF001 - of the process alone
    before = [mixture._each(o, a, reference=False)[1][0, 1] for o, a in zip(others, ahead, strict=True)]  # noqa: SLF001
    mixture.learn(here, np.append(1.0, np.full(8, np.nan)), np.full(9, NOISE), np.zeros(9))
    after = [mixture._each(o, a, reference=False)[1][0, 1] for o, a in zip(others, ahead, strict=True)]  # noqa: SLF001
    np.testing.assert_allclose(np.subtract(before, after), covered[0] ** 2 / (seen + NOISE**2), rtol=1e-6)
    assert not covered[1:].any()


def test_weights_and_their_covariance_are_those_of_the_linear_model() -> None:
    """w | y of y = X w + c + e, as a ridge regression has them."""
    mixture, x, draw = alone(Expert(1.0, 0.0)), features(60), np.random.default_rng(4)
    y = x @ draw.normal(size=FEATURES) + draw.normal(0, NOISE, 60)
    y[0] = 0.0
    fed(mixture, x, np.arange(60.0), y)
    noise = NOISE**2 * np.eye(60) + REFERENCE
    precision = x.T @ np.linalg.solve(noise, x) + np.eye(FEATURES) * FEATURES / UNIT**2
    wanted = np.linalg.solve(precision, x.T @ np.linalg.solve(noise, y))
    np.testing.assert_allclose(mixture.weights()[0] / mixture.believed[0], wanted, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(mixture.weight_covariance(0), np.linalg.inv(precision), rtol=1e-6, atol=1e-10)


def test_prior_variances_grow_where_the_evidence_is_and_the_likelihood_with_them() -> None:
    """One input matters: after some renewals its variance is the largest, and the measurements are likelier."""
    expert = Expert(0.5, 0.0005, evidence=True)
    x, draw = features(80, 6), np.random.default_rng(5)
    y = 2.0 * x[:, 2] + draw.normal(0, NOISE, 80)
    y[0] = 0.0
    mixture = alone(expert)
    fed(mixture, x, np.arange(80.0), y)
    found = mixture.state().relevance[0, 0]
    assert np.argmax(found) == 1

    def likelihood(relevance: Array) -> float:
        prior = (expert.linear * UNIT) ** 2 / FEATURES * np.repeat(relevance, LAGS)
        among = (x * prior) @ x.T + REFERENCE + NOISE**2 * np.eye(80)
        among += (expert.level * UNIT) ** 2 * np.minimum.outer(np.arange(80.0), np.arange(80.0))
        return float(-0.5 * (np.linalg.slogdet(among)[1] + y @ np.linalg.solve(among, y)))

    assert likelihood(found) > likelihood(np.ones(INPUTS)) + 1.0


def test_contributions_add_up_to_the_estimate_and_name_the_input_that_moves_it() -> None:
    mixture, x, draw = Mixture(INPUTS, LAGS, 300.0), features(60, 8), np.random.default_rng(5)
    x[:, 2:] *= 0.1
    y = np.tanh(3.0 * x[:, 0]) * 20.0 + draw.normal(0, NOISE, 60)
    y[0] = 0.0
    fed(mixture, x, 12 * np.arange(60.0), y)
    at = x[-1]
    parts, (level, _) = mixture.contributions(at), mixture.level()
    assert parts[0].sum() + level[0] == pytest.approx(mixture.predict(at)[0][0], abs=1e-3)
    assert np.argmax(np.abs(parts[0])) in (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("after", [50, MOST_ROWS + 15])
def test_a_restored_mixture_goes_on_bit_for_bit(after: int) -> None:
    mixture, draw = Mixture(INPUTS, LAGS, 300.0), np.random.default_rng(2)
    x = features(after + 20, 3)
    y = x[:, :1] * np.arange(1.0, 10.0) + draw.normal(0, NOISE, (len(x), 9))
    y[::7, 2] = np.nan
    other = Mixture(INPUTS, LAGS, 300.0)
    for k, row in enumerate(x):
        if k == after:
            other.restore(mixture.state())
        for one in (mixture, other) if k >= after else (mixture,):
            one.elapse(1)
            one.learn(row, y[k], np.full(9, NOISE), np.zeros(9))
    assert np.array_equal(mixture.predict(x[3])[0], other.predict(x[3])[0])
    assert np.array_equal(mixture.predict(x[3])[1], other.predict(x[3])[1])


def test_merged_measurements_say_what_they_said_apart() -> None:
    """A dense beginning, then rare measurements: nothing of it is forgotten when rows are merged."""
    draw, dense = np.random.default_rng(7), MOST_ROWS - 5
    t = np.append(np.arange(dense), dense + 24 * np.arange(1, 12))
    x = np.column_stack([np.sin(t / 40.0 + i) - np.sin(i) for i in range(FEATURES)])
    y = 10.0 * x[:, 0] + draw.normal(0, NOISE, len(t))
    y[0] = 0.0
    mixture = alone(SMOOTH)
    fed(mixture, x, t.astype(float), y)
    assert len(mixture.state().x) < MOST_ROWS
    for at in (x[20], x[150], x[-3]):
        mean, variance = posterior(SMOOTH, x, t.astype(float), y, at, float(t[-1]))
        ours, spread = mixture._each(at, 0, reference=False)  # noqa: SLF001 - of the process alone
        assert ours[0, 1] == pytest.approx(mean, abs=0.1 * NOISE)
        assert spread[0, 1] == pytest.approx(variance + (SMOOTH.misfit * UNIT) ** 2, rel=0.1)


def test_a_row_that_stands_for_four_measurements_has_a_quarter_of_their_noise() -> None:
    mixture, x, draw = alone(SMOOTH), features(20), np.random.default_rng(6)
    y = 2.0 * x[:, 1] + draw.normal(0, NOISE, 20)
    y[0] = 0.0
    fed(mixture, x, np.arange(20.0), y)
    mixture.restore(replace(mixture.state(), weight=np.full(20, 4.0)))
    noise = (NOISE**2 + (SMOOTH.misfit * UNIT) ** 2) / 4.0
    steps, at = np.arange(20.0), features(9, 3)[-1]
    among = covariance(SMOOTH, x, steps, x, steps) + REFERENCE + noise * np.eye(20)
    across = covariance(SMOOTH, x, steps, at[None], np.array([19.0]))[:, 0]
    ours, _ = mixture._each(at, 0, reference=False)  # noqa: SLF001 - of the process alone
    assert ours[0, 1] == pytest.approx(across @ np.linalg.solve(among, y), rel=1e-7)


def test_the_newest_measurements_are_never_merged() -> None:
    mixture, x = alone(LINEAR), features(MOST_ROWS + 1, 4)
    fed(mixture, x, np.arange(MOST_ROWS + 1.0), x[:, 0])
    kept = mixture.state()
    assert len(kept.x) < MOST_ROWS
    assert np.array_equal(kept.x[-41:], x[-41:])
    assert (kept.weight[-41:] == 1.0).all()
    assert kept.weight.sum() == MOST_ROWS + 1


def test_zero_is_as_likely_as_a_normal_distribution_of_noise_and_reference_says() -> None:
    mixture = Mixture(INPUTS, LAGS, 300.0)
    fed(mixture, features(1), np.zeros(1), np.array([1.3]))
    spread = NOISE**2 + REFERENCE
    assert mixture.state().evidence[0, 0] == pytest.approx(-0.5 * (np.log(spread) + 1.3**2 / spread))


def test_a_wider_span_changes_no_prediction_of_what_was_seen_and_tames_what_was_not() -> None:
    """An input that has not moved is as unknown per new span as it was per old span."""
    mixture, x = alone(Expert(1.0, 0.002)), features(30)
    x[:, 2:4] = 0.0
    fed(mixture, x, np.arange(30.0), np.append(0.0, x[1:, 0]))
    before = mixture.predict(x[-1])
    factor = np.ones(INPUTS)
    factor[1] = 64.0
    mixture.widen(factor)
    np.testing.assert_allclose(mixture.predict(x[-1]), before, rtol=1e-9)
    moved = x[-1].copy()
    moved[2:4] = 1.0
    assert mixture.predict(moved)[1][0] - before[1][0] == pytest.approx(2 * UNIT**2 / FEATURES, rel=1e-6)


def test_one_far_measurement_is_hardly_learnt_from_and_two_are_a_new_level() -> None:
    mixture, x = Mixture(INPUTS, LAGS, 300.0), np.zeros(FEATURES)
    y = np.append(np.random.default_rng(4).normal(0.0, NOISE, 40), [60.2, 59.8])
    fed(mixture, np.repeat(x[None], 41, axis=0), np.arange(41.0), y[:41])
    assert abs(mixture.predict(x)[0][0]) < 3.0
    fed(mixture, x[None], np.zeros(1), y[41:])
    assert mixture.predict(x)[0][0] == pytest.approx(60.0, abs=1.0)


def test_a_surprise_that_a_machine_could_bring_about_in_the_time_is_learnt_at_once() -> None:
    """28 µm in an hour, although the prediction was certain: the machine now behaves differently."""
    mixture, x = Mixture(INPUTS, LAGS, 300.0), np.zeros(FEATURES)
    y = np.random.default_rng(4).normal(3.0, NOISE, 40)
    y[0] = 0.0
    fed(mixture, np.repeat(x[None], 40, axis=0), np.arange(40.0), y)
    mixture.elapse(12)
    errors = np.full(9, np.nan)
    errors[0] = -25.0
    surprise = mixture.learn(x, errors, np.full(9, NOISE), np.zeros(9))
    assert abs(surprise.ratio[0]) > 5.0
    assert not surprise.outlier[0]
    assert mixture.predict(x)[0][0] == pytest.approx(-25.0, abs=3.0)


@pytest.mark.parametrize("reference", [-2.0, 2.0])
def test_what_only_the_reference_adds_is_not_believed_and_what_follows_an_input_is(reference: float) -> None:
    x, draw = features(250), np.random.default_rng(4)
    noise = draw.normal(reference * NOISE / np.sqrt(5.0), NOISE, 250)
    for error, believed in ((np.zeros(250), False), (1.0 * x[:, 0], True)):
        mixture = Mixture(INPUTS, LAGS, 300.0)
        fed(mixture, x, 12 * np.arange(250.0), error + noise)
        assert (mixture.believed[0] > 0.5) == believed


@pytest.mark.parametrize("size_um", [10.0, 40.0])
def test_one_measurement_that_an_input_explains_ends_a_long_rest_at_zero(size_um: float) -> None:
    """A machine stood cold for days and is switched on."""
    rest, mixture = 80, Mixture(INPUTS, LAGS, 300.0)
    x = np.zeros((rest + 1, FEATURES))
    x[rest, :LAGS] = size_um / UNIT
    y = np.random.default_rng(4).normal(0.0, NOISE, rest + 1) + np.append(np.zeros(rest), size_um)
    steps = 12 * np.arange(rest + 1.0)
    fed(mixture, x[:rest], steps[:rest], y[:rest])
    assert mixture.believed[0] < 0.1
    mixture.elapse(12)
    fed(mixture, x[rest:], steps[rest:], y[rest:])
    assert mixture.believed[0] > 0.99


def test_one_measurement_that_nothing_explains_does_not_end_a_rest_at_zero() -> None:
    rest, mixture, x = 80, Mixture(INPUTS, LAGS, 300.0), np.zeros(FEATURES)
    y = np.append(np.random.default_rng(4).normal(0.0, NOISE, rest), 40.0)
    fed(mixture, np.repeat(x[None], rest + 1, axis=0), np.arange(rest + 1.0), y)
    assert abs(mixture.predict(x)[0][0]) < 3.0


def test_an_error_that_is_not_measured_in_a_cycle_is_not_learnt() -> None:
    """The factor of one error is the same whether or not rows without it stand between."""
    mixture, sparse, x = alone(LINEAR), alone(LINEAR), features(20)
    both, one = np.full(9, np.nan), np.full(9, np.nan)
    for k, row in enumerate(x):
        both[:2] = one[0] = row[0]
        mixture.elapse(1)
        sparse.elapse(1)
        mixture.learn(row, both if k % 2 else one, np.full(9, NOISE), np.zeros(9))
        if k % 2:
            sparse.learn(row, both, np.full(9, NOISE), np.zeros(9))
    assert mixture.count.tolist() == [20, 10, 0, 0, 0, 0, 0, 0, 0]
    mean, variance = mixture.predict(x[-1])
    assert variance[0] < variance[1]
    assert variance[2] == 0.0
    assert mean[1] == pytest.approx(sparse.predict(x[-1])[0][1], rel=1e-9)


def test_the_default_experts_differ_by_more_than_their_sizes() -> None:
    """On a machine that is linear in one input the steady one wins, on one that saturates the supple one."""
    x = features(200, 11)
    noise = np.random.default_rng(12).normal(0, NOISE, 200)
    won = []
    for error in (4.0 * x[:, 0], 30.0 * np.tanh(x[:, 0]) * np.cos(x[:, 1])):
        mixture = Mixture(INPUTS, LAGS, 300.0)
        fed(mixture, x, 12 * np.arange(200.0), np.append(0.0, (error + noise)[1:]))
        won.append(int(np.argmax(mixture.share[0])))
    assert won == [1, 2]
    assert len(EXPERTS) == 2


def test_merged_rows_know_no_more_of_an_error_than_its_own_measurements_said() -> None:
    """The second error is measured every tenth time."""
    rows = Rows(1, 2)
    for i in range(5 * MOST_ROWS):
        if rows.is_full():
            rows.thin()
        rows.append(np.ones(1), float(i), np.zeros(2), np.ones(2), np.array([1.0, np.inf if i % 10 else 1.0]))
    told = (rows.weight[: rows.n, None] / rows.noise[: rows.n]).sum(axis=0)
    np.testing.assert_allclose(told, [5 * MOST_ROWS, 5 * MOST_ROWS / 10])
