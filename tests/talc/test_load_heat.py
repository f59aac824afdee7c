"""What loads do to temperatures, and the sensor check with them.

A matrix exponential gives the temperatures of the bodies (tests/benches/hot_bearing.py).
"""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from talc.load_heat import LAGS_S, heat_of, scale_of
from talc.sensor_check import Judgement, judge, rows_needed
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings
from tests.benches.hot_bearing import BODIES, DAY, NAMES, Array, bodies, work

SPEED = NAMES.index("spindle_speed")
SETTINGS = SensorCheckSettings()


def learnt(x: Array, loads: Sequence[str]) -> SensorModel:
    names = NAMES if loads else BODIES
    model = learn(names, x[:, : len(names)], np.ones((len(x), len(names)), np.bool_), SETTINGS, loads)
    assert model is not None
    return model


def judged(model: SensorModel, x: Array, known: NDArray[np.bool_] | None = None) -> Judgement:
    last = slice(-rows_needed(model, SETTINGS), None)
    valid = np.ones(x.shape, np.bool_) if known is None else known
    return judge(model, NAMES, x[last], valid[last], SETTINGS)


def suspects(judgement: Judgement) -> set[str]:
    return {name for finding in judgement.findings for name in finding.inputs}


@pytest.mark.parametrize("step_s", [60.0, 300.0, 3600.0])
def test_lagged_loads_are_the_digital_filter_they_stand_for(step_s: float) -> None:
    speed = work(3, 2)[:, None]
    scale = scale_of(("speed",), speed, np.ones(speed.shape, np.bool_), step_s)
    assert scale is not None
    features = scale.features(speed, np.ones(speed.shape, np.bool_))
    share = speed[:, 0] / speed.max()
    for i, steps in enumerate(lag_s / step_s for lag_s in (1800.0, 14400.0)):
        for j, driving in enumerate((share, share**2)):
            kept = np.exp(-1.0 / steps)
            expected = lfilter([1.0 - kept], [1.0, -kept], driving, zi=[kept * driving[0]])[0]
            np.testing.assert_allclose(features[:, 2 * i + j], expected, atol=1e-12)


@pytest.mark.parametrize("step_s", [300.0, 10.0])
def test_the_last_and_the_coming_features_are_those_of_the_digital_filter(step_s: float) -> None:
    speed, planned, steps = work(3, 2)[:, None], 900.0, 400
    scale = scale_of(("speed",), speed, np.ones(speed.shape, np.bool_), step_s)
    assert scale is not None
    last = scale.last_features(speed, np.ones(speed.shape, np.bool_))
    coming = scale.coming_features(last, np.array([planned]), steps)
    course = np.concatenate([speed[:, 0], np.full(steps, planned)]) / speed.max()
    for i, lag_s in enumerate(LAGS_S):
        for j, driving in enumerate((course, course**2)):
            kept = np.exp(-step_s / lag_s)
            expected = lfilter([1.0 - kept], [1.0, -kept], driving, zi=[kept * driving[0]])[0]
            np.testing.assert_allclose(last[2 * i + j], expected[len(speed) - 1], atol=1e-12)
            np.testing.assert_allclose(coming[:, 2 * i + j], expected[len(speed) :], atol=1e-12)


def test_an_unknown_load_is_held_for_an_hour_and_then_none() -> None:
    speed, known = np.full((40, 1), 500.0), np.ones((40, 1), np.bool_)
    known[10:30] = False
    speed[10:30] = 0.0
    scale = scale_of(("speed", "still"), np.hstack([speed, 0.0 * speed]), np.hstack([known, known]), 300.0)
    assert scale is None, "neither changed while it was known"
    speed[35:] = 1000.0
    scale = scale_of(("speed", "still"), np.hstack([speed, 0.0 * speed]), np.hstack([known, known]), 300.0)
    assert scale is not None
    assert (scale.names, scale.largest.tolist()) == (("speed",), [1000.0])
    short = scale.features(speed, known)[:, 0]
    np.testing.assert_allclose(short[:22], 0.5)
    np.testing.assert_allclose(short[22:30], 0.5 * np.exp(-np.arange(1, 9) * 300.0 / LAGS_S[0]))


def test_what_loads_explain_is_a_least_squares_regression() -> None:
    draw = np.random.default_rng(1)
    features, x = draw.normal(size=(400, 3)), draw.normal(size=(400, 2))
    x += features @ draw.normal(size=(3, 2))
    heat = heat_of(features, x)
    penalty = np.diag(np.sqrt(0.01 * 400 * features.var(axis=0)))
    off, target = features - features.mean(axis=0), x - x.mean(axis=0)
    expected = np.linalg.lstsq(np.vstack([off, penalty]), np.vstack([target, np.zeros((3, 2))]), rcond=None)[0]
    np.testing.assert_allclose(heat.weights, expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_bearing_that_runs_hot_is_found_only_with_the_load(seed: int) -> None:
    """Its neighbours hardly feel it, and its own temperature has often been as high: under higher loads."""
    speed, friction = work(seed, 9), np.ones(9 * DAY)
    friction[8 * DAY :] = 1.6
    x = bodies(speed, seed, friction)
    healthy, alone = learnt(x[: 8 * DAY], ["spindle_speed"]), learnt(x[: 8 * DAY], [])
    assert healthy.loads is not None
    found = judged(healthy, x)
    assert suspects(found) == {"bearing"}
    assert found.loads == ("spindle_speed",)
    assert judged(alone, x).findings == ()
    assert found.smallest_offset_K["bearing"] < 0.4 * judged(alone, x).smallest_offset_K["bearing"]


@pytest.mark.parametrize("seed", range(3))
def test_heat_of_a_higher_load_than_ever_accuses_no_sensor(seed: int) -> None:
    """Its neighbours cannot know that the bearing's heat comes from its speed."""
    speed = work(seed, 9)
    speed[8 * DAY :] = np.repeat([12000.0, 9000.0] * 6, 24)
    x = bodies(speed, seed)
    assert "bearing" in suspects(judged(learnt(x[: 8 * DAY], []), x))
    assert judged(learnt(x[: 8 * DAY], ["spindle_speed"]), x).findings == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_healthy_machine_is_not_accused_because_of_its_loads(seed: int) -> None:
    x = bodies(work(seed, 14), seed)
    model = learnt(x[: 8 * DAY], ["spindle_speed"])
    for end in range(9 * DAY, 14 * DAY + 1, 48):
        assert judged(model, x[:end]).findings == ()


def test_a_load_that_says_nothing_is_left_out() -> None:
    x = bodies(work(5, 8), 5)
    x[:, SPEED] = work(6, 8)
    assert learnt(x, ["spindle_speed"]).loads is None


def test_without_its_loads_a_window_is_judged_by_the_neighbours() -> None:
    speed = work(7, 9)
    x = bodies(speed, 7)
    x[8 * DAY :, BODIES.index("column")] += 5.0
    model, known = learnt(x[: 8 * DAY], ["spindle_speed"]), np.ones(x.shape, np.bool_)
    known[-60:, SPEED] = False
    x[-60:, SPEED] = np.nan
    found = judged(model, x, known)
    assert found.loads == ()
    assert "column" in suspects(found)
    alone = judged(learnt(x[: 8 * DAY], []), x, known)
    assert found.smallest_offset_K == pytest.approx(alone.smallest_offset_K, rel=1e-12)
