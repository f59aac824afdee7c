"""Planned loads: the forecast inputs and errors.

They are compared with the closed form of a lag and with a matrix exponential of the bodies
(tests/benches/hot_bearing.py).
"""

from functools import cache

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import Frame, Measurement
from talc.learner.features import LagBank
from talc.names import THERMAL_ERRORS
from talc.planned import LoadResponse, learn_response
from talc.settings import TalcSettings
from tests.benches.hot_bearing import DAY, NAMES, Array, bodies, work

LOADS = ("spindle_speed",)
SPEED = NAMES.index("spindle_speed")
BEARING, COLUMN = NAMES.index("bearing"), NAMES.index("column")
LEARNT = 10 * DAY
AHEAD = (6, 24, 96)


@cache
def future(planned: float) -> Array:
    """(10 days and 8 h, 6) of which the last 8 h run at the planned speed."""
    return bodies(np.append(work(1, 10), np.full(96, planned)), 1)


def response() -> LoadResponse:
    x = future(0.0)[:LEARNT]
    found = learn_response(NAMES, x, np.ones(x.shape, np.bool_), LOADS)
    assert found is not None
    return found


def changes(planned: float) -> Array:
    recent = future(0.0)[LEARNT - DAY : LEARNT]
    found = response().changes(NAMES, recent, np.ones(recent.shape, np.bool_), {"spindle_speed": planned}, 96)
    assert found is not None
    return found


def test_the_lags_along_a_path_are_those_of_the_closed_forms() -> None:
    constants, rng = (0.0, 1800.0, 7200.0), np.random.default_rng(2)
    bank = LagBank(3, constants, 300.0, 10.0)
    for row in rng.normal(size=(50, 3)):
        bank.advance(row)
    then = rng.normal(size=3)
    for step, features in zip(AHEAD, bank.along(np.tile(then, (96, 1)), AHEAD), strict=True):
        np.testing.assert_allclose(features, bank.towards(step, then), atol=1e-12)
    bank.restart(np.zeros(3))
    ramp = np.arange(1, 97)[:, None] * np.ones(3)  # a first-order lag of a ramp is the ramp, late by k / (1 - k) steps
    found = bank.along(ramp, AHEAD).reshape(3, 3, 3) * 10.0
    for j, constant in enumerate(constants):
        kept = np.exp(-300.0 / constant) if constant else 0.0
        late = kept / (1.0 - kept)
        expected = [n - late * (1.0 - kept**n) for n in AHEAD]
        np.testing.assert_allclose(found[:, 0, j], expected, rtol=1e-9)


@pytest.mark.parametrize("planned", [6000.0, 8000.0])
def test_the_bearing_follows_a_planned_speed_as_its_equations_say(planned: float) -> None:
    """Compared with no load at all in the same weather: the difference comes from the load."""
    found, truth = changes(planned) - changes(0.0), (future(planned) - future(0.0))[LEARNT:]
    off = found[:, BEARING] - truth[:, BEARING]
    assert np.sqrt(np.mean(off**2)) < 0.12 * np.sqrt(np.mean(truth[:, BEARING] ** 2))
    assert set(found[:, SPEED]) == {planned}


def test_a_bearing_that_already_has_the_planned_speed_warms_no_further() -> None:
    x = bodies(np.append(work(1, 10), np.full(96, 8000.0)), 1)
    recent, known = x[-DAY:], np.ones((DAY, 6), np.bool_)
    found = response().changes(NAMES, recent, known, {"spindle_speed": 8000.0}, 96)
    assert found is not None
    assert np.abs(found[:, BEARING]).max() < 0.1 * np.abs(changes(8000.0)[:, BEARING]).max()


def test_only_temperatures_that_a_load_changes_follow_the_loads() -> None:
    assert "hall" not in response().followers
    assert "bearing" in response().followers


def test_nothing_is_foreseen_of_a_planned_load_that_was_never_seen() -> None:
    recent = future(0.0)[LEARNT - DAY : LEARNT]
    known = np.ones(recent.shape, np.bool_)
    assert response().changes(NAMES, recent, known, {"spindle_speed": 12000.0}, 96) is None, "never as fast"
    assert response().changes(NAMES, recent, known, {"coolant": 1.0}, 96) is None, "never seen"


def test_no_response_is_learnt_from_less_than_two_days_or_with_a_load_that_never_changed() -> None:
    x = future(0.0)
    assert learn_response(NAMES, x[: 2 * DAY - 1], np.ones((2 * DAY - 1, 6), np.bool_), LOADS) is None
    still = x.copy()
    still[:, SPEED] = 0.0
    assert learn_response(NAMES, still, np.ones(x.shape, np.bool_), LOADS) is None


@pytest.mark.slow
def test_the_errors_are_foreseen_under_a_planned_load() -> None:
    """EZ0A is 3 µm/K of the bearing and 5 µm/K of the column; the learner learns this from hourly measurements."""
    x, column = future(0.0), THERMAL_ERRORS.index("EZ0A")
    truth = {planned: future(planned)[:, [BEARING, COLUMN]] @ [3.0, 5.0] for planned in (0.0, 8000.0)}
    controller = Controller(NAMES, TalcSettings())
    for k in range(LEARNT):
        errors = np.zeros(9)
        errors[column] = truth[0.0][k] - truth[0.0][0]
        measured = Measurement(errors, np.full(9, 0.5)) if k % 12 == 0 else None
        controller.step(Frame(k, x[k], np.ones(6, np.bool_), measured))
    found = {planned: controller.along(changes(planned), AHEAD).value[:, column] for planned in truth}
    later = [LEARNT - 1 + steps for steps in AHEAD]
    true = (truth[8000.0] - truth[0.0])[later]
    assert true.min() > 15.0
    np.testing.assert_allclose(found[8000.0] - found[0.0], true, rtol=0.2)
    with pytest.raises(ValueError, match="models"):
        Controller(NAMES, TalcSettings(method="models")).along(changes(0.0), AHEAD)


def test_a_load_that_runs_for_some_minutes_warms_as_its_equations_say_and_cools_again() -> None:
    recent = future(0.0)[LEARNT - DAY : LEARNT]
    known = np.ones(recent.shape, np.bool_)
    pulse = response().changes(NAMES, recent, known, {"spindle_speed": 6000.0}, 96, lasting=12)
    assert pulse is not None
    np.testing.assert_allclose(pulse[:12], changes(6000.0)[:12])
    before = work(1, 10)
    quiet, hour = (
        bodies(np.concatenate([before, np.full(12, speed), np.full(84, before[-1])]), 1)
        for speed in (before[-1], 6000.0)
    )
    truth = (hour - quiet)[LEARNT:, BEARING]
    held = response().changes(NAMES, recent, known, {"spindle_speed": float(before[-1])}, 96)
    assert held is not None
    found = (pulse - held)[:, BEARING]
    assert found[11] == pytest.approx(truth[11], rel=0.3)
    assert found[-1] < 0.3 * found[11], "it cools when the load ends"
    assert not pulse[12:, SPEED].any()
