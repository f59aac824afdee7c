"""The filters against closed forms."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from talc.learner import filters
from talc.learner.experts import UNIT, Expert
from talc.learner.mixture import Mixture

# The same models in closed form, as one dense normal distribution over all measurements; by SciPy, without filters.


Array = NDArray[np.float64]


def posterior(
    x: Array, steps: Array, y: Array, noise: float, prior: Array, growth: Array, at: Array, at_step: float
) -> tuple[float, float]:
    """Mean and variance of at' w at `at_step`, of y_k = x_k' w_k + e with w a random walk.

    x: (T, n); steps: (T,) of the measurements; noise: variance of e; prior: (n,) variance of w at steps[0];
    growth: (n,) per step.
    """
    shared = np.minimum(steps[:, None], steps[None, :]) - steps[0]
    among = (x * prior) @ x.T + shared * ((x * growth) @ x.T) + noise * np.eye(len(y))
    own = prior + growth * (at_step - steps[0])
    since = np.minimum(steps, at_step) - steps[0]
    across = (x * prior) @ at + since * ((x * growth) @ at)
    factor = cho_factor(among)
    mean = across @ cho_solve(factor, y)
    variance = at @ (own * at) - across @ cho_solve(factor, across)
    return float(mean), float(variance)


INPUTS, LAGS = 4, 2
NOISE = 0.7
REFERENCE = NOISE**2 / 5
"""Variance of the reference's noise."""


def features(count: int, seed: int = 0) -> Array:
    draw = np.random.default_rng(seed)
    walk = np.cumsum(draw.normal(size=(count, INPUTS * LAGS)), axis=0) * 0.3
    return np.column_stack([walk, np.ones(count)])


def with_reference(x: Array, share: float) -> Array:
    """(T, n + 1) the features, and whether the reference's noise counts."""
    return np.column_stack([x, np.full(len(x), share)])


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


@pytest.mark.parametrize(
    "expert",
    [
        Expert(1.0, 0.01),
        Expert(0.5, 0.02, 0.02),
        Expert(0.0, 0.04),
        Expert(1.0, 0.02, direct=True),
        Expert(2.5, 0.0005, misfit=0.05),
    ],
)
def test_one_filter_is_the_dense_normal_distribution_s_posterior(expert: Expert) -> None:
    count = 40
    x, draw = features(count), np.random.default_rng(1)
    steps = np.cumsum(draw.integers(1, 20, count)).astype(float)
    y = x[:, 0] * 0.8 - x[:, 3] * 0.5 + draw.normal(0, NOISE, count)
    y[0] = 0.3
    mixture = alone(expert)
    fed(mixture, x, steps, y)
    mixture.elapse(7)
    at = features(1, 5)[0]
    mean, variance = mixture.predict(at)
    features_count = INPUTS * LAGS
    own = np.full(features_count, expert.weight**2 * UNIT**2 / features_count)
    if expert.direct:  # all of it on the feature without a lag
        own = np.where(np.arange(features_count) % LAGS == 0, LAGS * own, 0.0)
    prior = np.append(own, [0.0, REFERENCE])
    drift = np.full(features_count, expert.drift**2 * UNIT**2 / features_count)
    growth = np.append(drift, [(expert.level * UNIT) ** 2, 0.0])
    misfit = (expert.misfit * UNIT) ** 2
    given = with_reference(x, 1.0), steps, y, NOISE**2 + misfit, prior, growth
    wanted = posterior(*given, np.append(at, 0.0), steps[-1] + 7)
    assert mean[0] == pytest.approx(wanted[0], rel=1e-9)
    assert variance[0] == pytest.approx(wanted[1] + misfit, rel=1e-9)
    seen = posterior(*given, np.append(at, 1.0), steps[-1] + 7)
    assert mixture.expect(at)[0][0] == pytest.approx(seen[0], rel=1e-9)
    assert mixture.expect(at)[1][0] == pytest.approx(seen[1] + misfit, rel=1e-9)
    each = [posterior(*given, one, steps[-1] + 7) for one in np.eye(len(at) + 1)[:-1]]
    np.testing.assert_allclose(mixture.weights()[0], [mean for mean, _ in each], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(mixture.variances()[0], [variance for _, variance in each], rtol=1e-8, atol=1e-12)


def test_a_measurement_narrows_another_prediction_by_their_covariance_squared() -> None:
    """Conditional variance of a joint normal distribution: Var(z | y) = Var(z) - Cov(z, y)² / (Var(y) + noise²)."""
    mixture, x = alone(Expert(1.0, 0.01, 0.02)), features(20)
    fed(mixture, x, np.arange(0.0, 60.0, 3.0), x[:, 0])
    mixture.elapse(5)
    here, others = features(1, 5)[0], features(3, 6)
    covariance, (_, spread) = mixture.covariance(here, others), mixture.expect(here)
    before = [mixture.predict(other)[1][0] for other in others]
    mixture.learn(here, np.append(1.0, np.full(8, np.nan)), np.full(9, NOISE), np.zeros(9))
    narrowed = [variance - mixture.predict(other)[1][0] for variance, other in zip(before, others, strict=True)]
    np.testing.assert_allclose(narrowed, covariance[0] ** 2 / (spread[0] + NOISE**2), rtol=1e-8)
    assert not covariance[1:].any()


def test_a_weight_s_variance_is_that_of_the_mixed_distributions() -> None:
    experts = (Expert(1.0, 0.01), Expert(0.0, 0.04))
    mixture = Mixture(INPUTS, LAGS, 300.0, experts)
    x = features(30)
    fed(mixture, x, np.arange(30.0), 0.8 * x[:, 0])
    draw, share, state = np.random.default_rng(0), mixture.weight[0], mixture.state()
    diagonal = [i * (i + 3) // 2 for i in range(INPUTS * LAGS + 1)]
    chosen = draw.choice(2, 200_000, p=share)
    drawn = draw.normal(state.mean[0, chosen, 0], np.sqrt(state.covariance[0, chosen, diagonal[0]]))
    assert 0.01 < share[1] < 0.99, "two that matter"
    assert mixture.weights()[0, 0] == pytest.approx(drawn.mean(), rel=0.02)
    assert mixture.variances()[0, 0] == pytest.approx(drawn.var(), rel=0.03)


def test_a_renewed_prior_gives_the_posterior_of_a_filter_that_began_with_it() -> None:
    """Conditioning on the change of a prior variance is exact, up and down, while weights do not drift."""
    n, x, draw = INPUTS * LAGS + 1, features(30), np.random.default_rng(2)
    y = x @ draw.normal(size=n) + draw.normal(0, NOISE, 30)
    prior = np.full(n, 0.6)
    for own, after in ((slice(2, 4), 0.05), (slice(4, 6), 3.0)):
        began = prior.copy()
        began[own] = after
        cov, mean = filtered(x, y, prior)
        filters.inform(
            cov, mean, np.array([0]), np.array([own.start]), 2, np.array([1.0 / after - 1.0 / prior[own.start]])
        )
        wanted_cov, wanted_mean = filtered(x, y, began)
        np.testing.assert_allclose(cov, wanted_cov, rtol=1e-8, atol=1e-11)
        np.testing.assert_allclose(mean, wanted_mean, rtol=1e-8, atol=1e-11)


def test_prior_variances_are_renewed_by_the_fixed_point_of_mackay() -> None:
    """v = (sum m^2 + k v0) / (sum (1 - P / v0) + k), within its bounds, and the posterior that belongs to it."""
    n, x, draw = INPUTS * LAGS + 1, features(30), np.random.default_rng(5)
    y = x @ np.where(np.arange(n) < 2, 0.8, 0.01) + draw.normal(0, NOISE, 30)
    prior = np.full((1, n), 0.2)
    cov, mean = filtered(x, y, prior[0])
    diagonal = cov[0, np.arange(n) * (np.arange(n) + 3) // 2]
    k, up, down = 0.5, 3.0, 0.1
    found = [
        (np.sum(mean[0, g] ** 2) + k * 0.2) / (np.sum(1.0 - diagonal[g] / 0.2) + k) for g in (slice(0, 2), slice(4, 6))
    ]
    began = prior[0].copy()
    began[0:2], began[4:6] = np.clip(found, down * 0.2, up * 0.2)
    rules = np.array([k, 0.0, down, up, 1e-4, 1e2])
    before = prior.copy()
    learn(cov, mean, np.zeros((1, n)), np.zeros(1), np.zeros(1), NOISE**2, (prior, before, np.array([0, 2]), rules))
    np.testing.assert_allclose(prior[0], began, rtol=1e-12)
    wanted_cov, wanted_mean = filtered(x, y, began)
    np.testing.assert_allclose(cov, wanted_cov, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(mean, wanted_mean, rtol=1e-8, atol=1e-11)


def test_one_filter_agrees_with_statsmodels() -> None:
    """The same model in the state-space form of another program, with missing measurements between."""
    from statsmodels.tsa.statespace.mlemodel import MLEModel  # a second that only this test needs to spend

    count, expert = 60, Expert(0.5, 0.02, drift=0.02)
    x, draw = features(count, 7), np.random.default_rng(8)
    y = 0.5 * x[:, 0] + draw.normal(0, NOISE, count)
    y[0] = 0.1
    y[np.arange(count) % 3 != 0] = np.nan
    n, size = x.shape[1] + 1, INPUTS * LAGS
    design = with_reference(x, 1.0).T[None]
    model = MLEModel(y, k_states=n, k_posdef=n, design=design, transition=np.eye(n), selection=np.eye(n))
    model["obs_cov"] = np.array([[NOISE**2]])
    growth = np.append(np.full(size, (expert.drift * UNIT) ** 2 / size), [(expert.level * UNIT) ** 2, 0.0])
    model["state_cov"] = np.diag(growth)
    first = np.append(np.full(size, (expert.weight * UNIT) ** 2 / size), [0.0, REFERENCE])
    model.ssm.initialize_known(np.zeros(n), np.diag(first))
    theirs = model.ssm.filter()
    mixture = alone(expert)
    for k, row in enumerate(x):
        if k:
            mixture.elapse(1)
            mean, variance = mixture.expect(row)
            assert mean[0] == pytest.approx(theirs.forecasts[0, k], rel=1e-8, abs=1e-10)
            assert variance[0] + NOISE**2 == pytest.approx(theirs.forecasts_error_cov[0, 0, k], rel=1e-8)
        if np.isfinite(y[k]):
            errors = np.full(9, np.nan)
            errors[0] = y[k]
            mixture.learn(row, errors, np.full(9, NOISE), np.zeros(9))


def filtered(x: Array, y: Array, prior: Array) -> tuple[Array, Array]:
    """One filter without drift, by the kernel."""
    n = x.shape[1]
    cov, mean = np.zeros((1, n * (n + 1) // 2)), np.zeros((1, n))
    cov[0, np.arange(n) * (np.arange(n) + 3) // 2] = prior
    gain, spread, still = np.empty((1, n)), np.empty(1), np.zeros((1, n))
    for row, value in zip(x, y, strict=True):
        filters.look(cov, still, row, gain, spread)
        learn(cov, mean, gain, spread, np.array([value - mean[0] @ row]), NOISE**2)
    return cov, mean


def learn(
    cov: Array,
    mean: Array,
    gain: Array,
    spread: Array,
    innovation: Array,
    noise: float,
    evidence: tuple[Array, Array, NDArray[np.int64], Array] | None = None,
) -> Array:
    """One filter takes in an innovation. evidence: its prior, the first one, inputs to be renewed, and the rules.
    Returns the mixture's covariance."""
    prior, first, groups, rules = evidence or (*np.ones((2, *mean.shape)), np.array([0]), np.ones(6))
    which, mixed = np.zeros(0 if evidence is None else 1, dtype=np.int64), np.empty(cov.shape[1])
    own = prior, first, which, groups, LAGS, rules
    filters.learn(cov, mean, gain, spread, innovation, noise, *own, np.array([0.5]), 0.0, mixed)
    return mixed


def test_covariances_stay_positive_over_long_runs_without_drift() -> None:
    """Little noise, wide prior, features up to their bound, 20,000 measurements."""
    draw, n = np.random.default_rng(3), INPUTS * LAGS + 1
    # Lags of the same input nearly repeat each other.
    common = draw.uniform(-8, 8, (20000, INPUTS))
    x = np.column_stack(
        [np.repeat(common, LAGS, axis=1) + 1e-4 * draw.normal(size=(20000, INPUTS * LAGS)), np.ones(20000)]
    )
    cov, mean = np.zeros((1, n * (n + 1) // 2)), np.zeros((1, n))
    cov[0, np.arange(n) * (np.arange(n) + 3) // 2] = 900.0
    gain, spread, still = np.empty((1, n)), np.empty(1), np.zeros((1, n))
    for k, row in enumerate(x):
        filters.look(cov, still, row, gain, spread)
        learn(cov, mean, gain, spread, np.zeros(1), 0.0625)
        if k % 1000 == 999:
            full = np.zeros((n, n))
            full[np.tril_indices(n)] = cov[0]
            full = full + np.tril(full, -1).T
            assert np.linalg.eigvalsh(full).min() > 0.0


def test_a_wider_span_changes_no_prediction_of_what_was_seen_and_tames_what_was_not() -> None:
    """An input that has not moved is as unknown per new span as it was per old span."""
    mixture, x = alone(Expert(1.0, 0.002)), features(30)
    x[:, 2:4] = 0.0
    steps = np.arange(30.0)
    fed(mixture, x, steps, np.append(0.0, x[1:, 0]))
    before = mixture.predict(x[-1])
    factor = np.ones(INPUTS)
    factor[1] = 64.0
    mixture.widen(factor)
    after = mixture.predict(x[-1])
    np.testing.assert_allclose(after, before, rtol=1e-9)
    moved = x[-1].copy()
    moved[2:4] = 1.0
    assert mixture.predict(moved)[1][0] - before[1][0] == pytest.approx(2 * UNIT**2 / (INPUTS * LAGS), rel=1e-6)


def test_one_far_measurement_is_hardly_learnt_from_and_two_are_a_new_level() -> None:
    mixture = Mixture(INPUTS, LAGS, 300.0)
    x = np.append(np.zeros(INPUTS * LAGS), 1.0)
    draw = np.random.default_rng(4)
    y = np.append(draw.normal(0.0, NOISE, 40), [60.0, 60.0])
    fed(mixture, np.repeat(x[None], 41, axis=0), np.arange(41.0), y[:41])
    assert abs(mixture.predict(x)[0][0]) < 3.0
    fed(mixture, x[None], np.zeros(1), y[41:])
    assert mixture.predict(x)[0][0] == pytest.approx(60.0, abs=1.0)


def test_a_surprise_that_a_machine_could_bring_about_in_the_time_is_learnt_at_once() -> None:
    """28 µm in an hour, although the prediction was certain: the machine now behaves differently."""
    mixture = Mixture(INPUTS, LAGS, 300.0)
    x = np.append(np.zeros(INPUTS * LAGS), 1.0)
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


def test_the_hypothesis_of_zero_knows_the_noise_of_the_reference() -> None:
    """It allows the mean of a normal distribution given the measurements, a priori a mean of five."""
    y = np.random.default_rng(3).normal(0.4, NOISE, 12)
    mixture = Mixture(INPUTS, LAGS, 300.0)
    fed(mixture, features(12), np.arange(12.0), y)
    mean, variance = mixture.state().shift[0]
    assert variance == pytest.approx(NOISE**2 / (5 + 12))
    assert mean == pytest.approx(y.sum() / (5 + 12))


@pytest.mark.parametrize("reference", [-2.0, 2.0])
def test_what_only_the_reference_adds_is_not_believed_and_what_follows_an_input_is(reference: float) -> None:
    x, draw = features(300), np.random.default_rng(4)
    shift = reference * NOISE / np.sqrt(5.0)
    noise = draw.normal(shift, NOISE, 300)
    for error, believed in ((np.zeros(300), False), (1.0 * x[:, 0], True)):
        mixture = Mixture(INPUTS, LAGS, 300.0)
        fed(mixture, x, 12 * np.arange(300.0), error + noise)
        assert (mixture.believed[0] > 0.5) == believed


@pytest.mark.parametrize("size_um", [10.0, 40.0])
def test_one_measurement_that_an_input_explains_ends_a_long_rest_at_zero(size_um: float) -> None:
    """A machine stood cold for days and is switched on: the larger its first measurement, the less likely it is
    zero."""
    rest, mixture = 80, Mixture(INPUTS, LAGS, 300.0)
    x = np.zeros((rest + 1, INPUTS * LAGS + 1))
    x[:, -1] = 1.0
    x[rest, :LAGS] = size_um / UNIT
    y = np.random.default_rng(4).normal(0.0, NOISE, rest + 1) + np.append(np.zeros(rest), size_um)
    steps = 12 * np.arange(rest + 1.0)
    fed(mixture, x[:rest], steps[:rest], y[:rest])
    assert mixture.believed[0] < 0.01
    mixture.elapse(12)
    fed(mixture, x[rest:], steps[rest:], y[rest:])
    assert mixture.believed[0] > 0.999


def test_one_measurement_that_nothing_explains_does_not_end_a_rest_at_zero() -> None:
    rest, mixture = 80, Mixture(INPUTS, LAGS, 300.0)
    x = np.append(np.zeros(INPUTS * LAGS), 1.0)
    y = np.append(np.random.default_rng(4).normal(0.0, NOISE, rest), 40.0)
    fed(mixture, np.repeat(x[None], rest + 1, axis=0), np.arange(rest + 1.0), y)
    assert mixture.believed[0] < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_what_the_reference_adds_to_an_error_that_stays_zero_is_not_corrected(seed: int) -> None:
    """Five measurements may be off by a standard deviation of one: then all later ones show that, but the error does
    not."""
    draw = np.random.default_rng(seed)
    mixture, x = Mixture(INPUTS, LAGS, 300.0), features(60, seed)
    fed(mixture, x, 12 * np.arange(60.0), draw.normal(NOISE, NOISE, 60))
    assert abs(mixture.predict(x[-1])[0][0] * mixture.believed[0]) < 0.25 * NOISE
    assert mixture.expect(x[-1])[0][0] == pytest.approx(NOISE, abs=0.6 * NOISE)


def test_an_error_that_is_not_measured_in_a_cycle_is_not_learnt() -> None:
    mixture, x = Mixture(INPUTS, LAGS, 300.0), features(20)
    both, one = np.full(9, np.nan), np.full(9, np.nan)
    for k, row in enumerate(x):
        both[:2] = one[0] = row[0]
        mixture.elapse(1)
        mixture.learn(row, both if k < 10 else one, np.full(9, NOISE), np.zeros(9))
    assert mixture.count.tolist() == [20, 10, 0, 0, 0, 0, 0, 0, 0]
    variance = mixture.predict(x[-1])[1]
    assert variance[0] < variance[1]
    assert variance[2] == 0.0
