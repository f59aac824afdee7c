"""A year, a day, an hour and a lag at other grid steps than the default: what they last does not change.

Days of 5 min become days of 10 min by every second row.
"""

import numpy as np
import pytest

from talc.learner import inputs as memory
from talc.load_heat import scale_of
from talc.planned import learn_response
from talc.sensor_check import judge, rows_needed
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings
from talc.steps import steps_in
from tests.benches.hot_bearing import BODIES, DAY, NAMES, Array, bodies, work

STEP_S = 600.0
EIGHT_HOURS = SensorCheckSettings(window_steps=48, learn_steps=4320)
LOADS = ("spindle_speed",)


def learnt(x: Array, settings: SensorCheckSettings = EIGHT_HOURS, step_s: float = STEP_S) -> SensorModel | None:
    return learn(NAMES, x, np.ones(x.shape, np.bool_), settings, LOADS, step_s)


@pytest.mark.parametrize(
    ("duration_s", "step_s", "steps"), [(3600.0, 300.0, 12), (86400.0, 420.0, 206), (1800.0, 7200.0, 1)]
)
def test_a_time_is_the_nearest_number_of_steps_and_at_least_one(duration_s: float, step_s: float, steps: int) -> None:
    assert steps_in(duration_s, step_s) == steps


@pytest.mark.parametrize(("step_s", "window_steps"), [(300.0, 96), (600.0, 48), (60.0, 480)])
def test_a_false_alarm_a_year_is_one_a_year(step_s: float, window_steps: int) -> None:
    draw = np.random.default_rng(3)
    x = draw.normal(size=(4 * window_steps, 4)) + draw.normal(size=(4 * window_steps, 1))
    settings = SensorCheckSettings(window_steps=window_steps, learn_steps=4 * window_steps)
    model = learn("abcd", x, np.ones(x.shape, np.bool_), settings, (), step_s)
    assert model is not None
    assert model.swap_threshold == pytest.approx(np.log(4 * 3 / 2 * 365.25 * 24 / 8))


def test_a_bearing_that_runs_hot_is_found_at_ten_minutes() -> None:
    friction = np.ones(9 * DAY)
    friction[8 * DAY :] = 1.6
    x = bodies(work(0, 9), 0, friction)[::2]
    model = learnt(x[: 4 * DAY])
    assert model is not None
    assert model.loads is not None
    assert rows_needed(model, EIGHT_HOURS) == 48 + 3 + 144, "8 h, half an hour and a day"
    rows = x[-rows_needed(model, EIGHT_HOURS) :]
    found = judge(model, NAMES, rows, np.ones(rows.shape, np.bool_), EIGHT_HOURS)
    assert [finding.inputs for finding in found.findings] == [("bearing",)]


def test_an_unknown_load_is_held_for_an_hour_at_ten_minutes() -> None:
    speed, known = np.full((40, 1), 500.0), np.ones((40, 1), np.bool_)
    speed[0], known[10:30] = 1000.0, False
    scale = scale_of(LOADS, speed, known, STEP_S)
    assert scale is not None
    short = scale.features(speed, known)[:, 0]
    assert (np.diff(short[17:30]) < -1e-3).all(), "none from the seventh unknown row on"
    held = 0.5 + 0.5 * np.exp(-np.arange(16) / 3.0)
    np.testing.assert_allclose(short[:16], held)


def test_a_planned_load_needs_two_days_at_any_step() -> None:
    x = bodies(work(1, 3), 1)[::2]
    for rows, known in ((DAY, True), (DAY - 1, False)):
        part = x[:rows]
        found = learn_response(NAMES, part, np.ones(part.shape, np.bool_), LOADS, STEP_S)
        assert (found is not None) == known


def test_a_window_shorter_than_half_an_hour_is_learnt_from_where_rows_were_half_an_hour_earlier() -> None:
    """The first windows of a record have no such rows."""
    x, settings = bodies(work(2, 6), 2), SensorCheckSettings(window_steps=12, learn_steps=1440)
    assert learnt(x[:170], settings, 10.0) is None, "28 min: no row is half an hour after another"
    model = learnt(x[:1440], settings, 10.0)
    assert model is not None
    assert model.names == BODIES
    for view in (model.level, model.change):
        assert np.isfinite(view.covariance).all()
        assert np.isfinite(view.pairs).all()


@pytest.mark.parametrize(("step_s", "rows"), [(300.0, 4032), (600.0, 2016), (3600.0, 336)])
def test_the_learner_remembers_the_inputs_of_two_weeks(step_s: float, rows: int) -> None:
    usual, known = memory.InputMemory(1, step_s), np.ones(1, np.bool_)
    for _ in range(rows):
        usual.fill(np.zeros(1), known)
    for _ in range(rows):
        usual.fill(np.ones(1), known)
    assert usual.mean[0] == pytest.approx(1.0 - (1.0 - 1.0 / rows) ** rows)
