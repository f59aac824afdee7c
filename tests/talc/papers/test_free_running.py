"""One model in operation, against a plain NumPy twin of the kernel's equations and closed forms."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from talc.disturbance import Disturbance, disturbance_of
from talc.models import ErrorModel
from talc.papers.free_running import FreeRunningModel

Array = NDArray[np.float64]


def make(disturbance: Disturbance | None = None, **changes: object) -> ErrorModel:
    fields: dict[str, object] = {
        "error": "EZ0T",
        "inputs": ("first", "second"),
        "a": np.array([-1.5, 0.56]),
        "b": (np.array([0.1, 0.05, -0.02]), np.array([0.3])),
        "intercept": 0.1,
        "u_mean": np.array([20.0, 25.0]),
        "u_std": np.array([2.0, 3.0]),
        "y_mean": 5.0,
        "y_std": 4.0,
        "u_low": np.array([0.0, 0.0]),
        "u_high": np.array([50.0, 60.0]),
        "y_low": -500.0,
        "y_high": 500.0,
        "limit": 3.0,
        "training_limit": 2.0,
        "residual_std": 1.0,
        "criterion": 0.0,
        "disturbance": disturbance or Disturbance(),
    }
    return ErrorModel(**(fields | changes))  # type: ignore[arg-type]


def bank(n: int = 4) -> Disturbance:
    draw = np.random.default_rng(1)
    return Disturbance(0.7, draw.uniform(0.9, 0.999, n), draw.uniform(0.05, 1.0, n), draw.normal(size=n))


def inputs(steps: int, seed: int = 0) -> Array:
    draw = np.random.default_rng(seed)
    walk: Array = np.cumsum(draw.normal(0, 0.3, (steps, 2)), axis=0)
    rows: Array = walk + np.array([20.0, 25.0])
    return rows


def twin(model: ErrorModel, rows: Array, measured: Array, start: float) -> tuple[Array, Array]:
    """Predictions and standard deviations after each row, written from the equations of talc.disturbance's paper."""
    u = (np.clip(rows, model.u_low, model.u_high) - model.u_mean) / model.u_std
    before = np.vstack([np.repeat(u[:1], 10, axis=0), u])
    past = [(start - model.y_mean) / model.y_std] * model.na
    d = model.disturbance
    offset, variance = np.zeros(d.poles.size), np.full(d.poles.size, model.y_std**2)
    weight = np.exp(d.log_weights)
    predicted, sigma = [], []
    for k in range(len(u)):
        y = model.intercept - float(model.a @ np.array(past))
        y += sum(float(b[j]) * float(before[10 + k - j, s]) for s, b in enumerate(model.b) for j in range(b.size))
        past = [y, *past[:-1]]
        offset, variance = d.poles * offset, d.poles**2 * variance + d.drifts**2
        value = float(y) * model.y_std + model.y_mean
        predicted.append(value + float(np.average(offset, weights=weight)))
        if np.isfinite(measured[k]):
            innovation, spread = measured[k] - value - offset, variance + d.noise_std**2
            weight = weight * np.exp(-0.5 * innovation**2 / spread) / np.sqrt(spread)
            offset, variance = offset + variance / spread * innovation, variance * d.noise_std**2 / spread
        mean = np.average(offset, weights=weight)
        sigma.append(np.sqrt(np.average(variance + (offset - mean) ** 2, weights=weight)))
    return np.array(predicted), np.array(sigma)


def test_the_kernel_follows_its_equations() -> None:
    model, rows = make(bank()), inputs(400)
    measured = np.full(400, np.nan)
    measured[::7] = 5.0 + 3.0 * np.sin(np.arange(0, 400, 7) / 20.0)
    running = FreeRunningModel(model, [0, 1])
    estimates = [running.step(row, y) for row, y in zip(rows, measured, strict=True)]
    expected, sigma = twin(model, rows, measured, model.y_mean)
    np.testing.assert_allclose([e.predicted for e in estimates], expected, rtol=1e-10)
    np.testing.assert_allclose([e.sigma for e in estimates], sigma, rtol=1e-8)
    np.testing.assert_allclose(model.free_run(rows, measured, model.y_mean), expected, rtol=1e-10)


def test_without_measurements_it_is_the_linear_filter() -> None:
    model, rows = make(intercept=0.0), inputs(300)
    rows[:5] = model.u_mean  # at rest before the record
    u = (rows - model.u_mean) / model.u_std
    scaled = lfilter(model.b[0], [1.0, *model.a], u[:, 0]) + lfilter(model.b[1], [1.0, *model.a], u[:, 1])
    predicted = model.free_run(rows, np.full(300, np.nan), model.y_mean)
    np.testing.assert_allclose(predicted, scaled * model.y_std + model.y_mean, atol=1e-9)


def test_a_state_update_moves_the_whole_history_by_the_residual() -> None:
    # Two slow poles: replacing only the newest output would feign a jump and overshoot.
    model = make(resets_history=True, intercept=0.0)
    rows, measured = np.tile(model.u_mean, (30, 1)), np.full(30, np.nan)
    measured[10] = model.y_mean + 8.0
    predicted = model.free_run(rows, measured, model.y_mean)
    assert predicted[10] == pytest.approx(model.y_mean)
    assert predicted[11:].max() <= model.y_mean + 8.0 + 1e-9
    decay = lfilter([1.0], [1.0, *model.a], np.zeros(19), zi=_history(model.a, 8.0))[0]
    np.testing.assert_allclose(predicted[11:] - model.y_mean, decay, atol=1e-9)


def _history(a: Array, level: float) -> Array:
    """lfilter's state when all past outputs stood at `level`."""
    return np.array([-float(a[i:].sum()) * level for i in range(a.size)])


def test_uncertainty_grows_with_time_since_the_measurement_and_shrinks_with_it() -> None:
    running = FreeRunningModel(make(bank()), [0, 1])
    for _ in range(50):
        running.step(np.array([20.0, 25.0]), 5.0)
    later = [running.step(np.array([20.0, 25.0]), np.nan).sigma for _ in range(100)]
    assert (np.diff(later) > 0).all()
    assert running.step(np.array([20.0, 25.0]), 5.0).sigma < 0.5 * later[-1]


def test_uncertainty_grows_when_inputs_leave_what_training_saw() -> None:
    model = make(bank(), leverage=np.eye(4), leverage_limit=9.0, novelty_std=0.5)
    near, far = FreeRunningModel(model, [0, 1]), FreeRunningModel(model, [0, 1])
    familiar = near.step(model.u_mean + 0.01 * model.u_std, np.nan)
    strange = far.step(model.u_mean + 8.0 * model.u_std, np.nan)
    assert familiar.novelty < 1.0 < strange.novelty
    # At rest every regressor is u / (1 + sum a): three of the first input, one of the second, each (8 / 0.06)².
    leverage = 4.0 * (8.0 / 0.06) ** 2
    assert strange.novelty == pytest.approx(leverage / 9.0)
    assert strange.sigma**2 == pytest.approx(familiar.sigma**2 + 0.25 * (leverage - 9.0))


def test_no_known_noise_takes_a_measurement_whole() -> None:
    d = Disturbance(0.0, np.array([0.99]), np.array([0.5]), np.zeros(1))
    running = FreeRunningModel(make(d), [0, 1])
    assert running.step(np.array([20.0, 25.0]), 42.0).corrected == pytest.approx(42.0)


def test_a_restored_state_goes_on_bit_for_bit() -> None:
    model, rows = make(bank()), inputs(60)
    measured = np.where(np.arange(60) % 9 == 0, 7.0, np.nan)
    whole, first = FreeRunningModel(model, [0, 1]), FreeRunningModel(model, [0, 1])
    expected = [whole.step(row, y) for row, y in zip(rows, measured, strict=True)]
    for row, y in zip(rows[:33], measured[:33], strict=True):
        first.step(row, y)
    second = FreeRunningModel(model, [0, 1])
    second.restore(first.state())
    assert [second.step(row, y) for row, y in zip(rows[33:], measured[33:], strict=True)] == expected[33:]
    with pytest.raises(ValueError, match="not one of this model"):
        FreeRunningModel(make(), [0, 1]).restore(first.state())


def test_likelihoods_are_those_of_the_dense_gaussian() -> None:
    draw = np.random.default_rng(5)
    steps = np.cumsum(draw.integers(1, 5, 60))
    disturbance, level = [], 0.0
    for h in np.diff(steps, prepend=steps[0] - 1):
        for _ in range(h):
            level = 0.97 * level + 0.3 * draw.normal()
        disturbance.append(level)
    residual = np.array(disturbance) + draw.normal(0, 0.4, 60)
    found = disturbance_of(residual, steps)
    ratio = (found.drifts / found.noise_std) ** 2
    lag = np.abs(steps[:, None] - steps[None, :])
    logs = []
    for pole, q in zip(found.poles, ratio, strict=True):
        covariance = q / (1 - pole**2) * pole**lag + np.eye(60)
        square = float(residual @ np.linalg.solve(covariance, residual))
        logs.append(-0.5 * (60 * np.log(square / 60) + np.linalg.slogdet(covariance)[1]))
    expected = np.array(logs) - max(logs)
    np.testing.assert_allclose(found.log_weights / 0.05, expected, atol=1e-6)


def test_the_true_disturbance_is_among_the_likely_ones() -> None:
    draw = np.random.default_rng(6)
    d = lfilter([0.3], [1.0, -0.97], draw.normal(size=3000))
    found = disturbance_of(d + draw.normal(0, 0.5, 3000), np.arange(3000))
    best = int(np.argmax(found.log_weights))
    assert found.poles[best] == pytest.approx(0.97)
    assert found.drifts[best] == pytest.approx(0.3, rel=0.5)
    assert found.noise_std == pytest.approx(0.5, rel=0.15)


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_too_few_residuals_still_give_a_disturbance(rows: int) -> None:
    found = disturbance_of(np.ones(rows), np.arange(rows))
    assert found.noise_std == 0.0
    assert np.isfinite(found.drifts).all()
