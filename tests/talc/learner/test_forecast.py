"""What the learner says of the hours ahead, and how its record of earlier forecasts judges it."""

from dataclasses import replace

import numpy as np
import pytest

from talc.control import Controller
from talc.forecast import Forecast, ForecastRecord
from talc.frame import Frame, Measurement
from talc.settings import TalcSettings
from tests.benches.thermal_series import series, without_ninth

SIGMA = np.full(9, 0.5)
GOOD = np.ones(12, dtype=np.bool_)
AHEAD = (6, 24, 96)


@pytest.fixture(scope="module")
def taught() -> tuple[Controller, np.ndarray]:
    """A controller after a day, and the inputs of the last row."""
    days = without_ninth(series(288, 3))
    controller = Controller(days.names, TalcSettings(method="learner"))
    for k, row in enumerate(days.inputs):
        controller.step(Frame(k, row, GOOD, Measurement(days.measured[k], SIGMA) if k % 11 == 0 else None))
    return controller, days.inputs[-1]


def forecast_of(controller: Controller) -> Forecast:
    found = controller.forecast(AHEAD)
    assert found is not None
    return found


def continued(controller: Controller, row: np.ndarray, *, measured: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """(3, 9) estimates and sigmas at AHEAD of a copy of the controller whose inputs have this row from now on."""
    copy = Controller.restore(controller.state(), TalcSettings(method="learner"))
    found = []
    for k in range(288, 288 + AHEAD[-1]):
        now = copy.forecast((1,))
        assert now is not None
        known = Measurement(now.value[0], np.full(9, 1.0)) if measured and k == 288 else None
        decision = copy.step(Frame(k, row, GOOD, known))
        if k - 287 in AHEAD:
            found.append((decision.corrected, decision.sigma))
    return np.stack([f[0] for f in found]), np.stack([f[1] for f in found])


def test_while_the_inputs_stay_the_forecast_comes_true(taught: tuple[Controller, np.ndarray]) -> None:
    controller, row = taught
    said = forecast_of(controller)
    value, sigma = continued(controller, row)
    np.testing.assert_allclose(said.value, value, atol=1e-9)
    np.testing.assert_allclose(said.sigma, sigma, atol=1e-9)
    assert said.ahead_s == (1800.0, 7200.0, 28800.0)


def test_inputs_that_come_to_their_mean_move_the_estimate_as_was_said(taught: tuple[Controller, np.ndarray]) -> None:
    controller, _ = taught
    days = without_ninth(series(288, 3))
    said = forecast_of(controller)
    value, _ = continued(controller, days.inputs.mean(axis=0))
    np.testing.assert_allclose(said.usual_value, value, atol=1e-9)


def test_a_measurement_now_narrows_the_hours_ahead_and_the_less_the_farther(
    taught: tuple[Controller, np.ndarray],
) -> None:
    """What a measurement brings at the same features is the conditional variance of a joint normal distribution."""
    controller, row = taught
    said = forecast_of(controller)
    assert (said.measured_sigma <= said.sigma + 1e-12).all()
    gain = 1.0 - (said.measured_sigma / said.sigma)[:, :8] ** 2
    assert gain[0].mean() > gain[-1].mean()
    _, sigma = continued(controller, row, measured=True)
    # A measurement that finds what was expected also makes the learner surer of itself, which the forecast must not
    # promise.
    assert (said.measured_sigma[0, :8] >= 0.95 * sigma[0, :8]).all()


def test_before_the_first_frame_there_is_no_forecast_and_before_a_measurement_no_number() -> None:
    controller = Controller(("a", "b"), TalcSettings(method="learner"))
    assert controller.forecast(AHEAD) is None
    controller.step(Frame(0, np.array([20.0, 21.0]), np.ones(2, dtype=np.bool_)))
    assert np.isnan(forecast_of(controller).value).all()
    assert np.isnan(forecast_of(controller).measured_sigma).all()


def plain(k: int, value: float, sigma: float = 1.0) -> Forecast:
    nines = np.full((2, 9), value)
    return Forecast(k, (2, 4), (600.0, 1200.0), nines, np.full((2, 9), sigma), nines, nines, nines)


def test_a_record_is_silent_until_forecasts_over_as_long_a_time_have_come_due() -> None:
    record = ForecastRecord((2, 4), 300.0)
    known = []
    for k in range(9):
        misses = record.take(plain(k, 0.0), np.full(9, 3.0), np.full(9, 1.5), measured=False)
        known.append(np.isfinite(misses.value).all(axis=1).tolist())
    assert known == [[False, False]] * 3 + [[True, False]] * 4 + [[True, True]] * 2
    np.testing.assert_allclose(misses.value, 3.0)
    np.testing.assert_allclose(misses.sigma, 0.5)


def test_sigma_is_judged_only_where_no_measurement_came_meanwhile() -> None:
    record = ForecastRecord((2, 4), 300.0)
    for k in range(40):
        misses = record.take(plain(k, 0.0), np.zeros(9), np.full(9, 2.0), measured=k % 3 == 0)
    assert np.isfinite(misses.value).all()
    np.testing.assert_allclose(misses.sigma[0], 1.0)
    assert np.isnan(misses.sigma[1]).all()


def test_a_value_that_was_not_known_then_or_now_is_not_a_miss() -> None:
    record = ForecastRecord((2, 4), 300.0)
    unknown = replace(plain(0, np.nan), k=0)
    for k in range(12):
        misses = record.take(replace(unknown, k=k), np.zeros(9), np.ones(9), measured=False)
    assert np.isnan(misses.value).all()
    np.testing.assert_allclose(misses.sigma, 0.0)
