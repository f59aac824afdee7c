"""Sensors against each other: the algebra against plain regressions, then seeded plants with offsets and exchanges."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from talc.sensor_check import Judgement, judge
from talc.sensor_model import SensorModel, learn, leave_one_out, leave_two_out, precision_of
from talc.settings import SensorCheckSettings
from tests.benches.plant_days import DAY, NAMES, Array, plant_days

SETTINGS = SensorCheckSettings()
WINDOW = SETTINGS.window_steps + 6
SEEDS = (11, 12, 13, 14)


@cache
def learnt(seed: int, days: int = 3) -> SensorModel:
    x = plant_days(seed)[: days * DAY]
    model = learn(NAMES, x, np.ones(x.shape, np.bool_), SETTINGS)
    assert model is not None
    return model


def judged(seed: int, x: Array, valid: NDArray[np.bool_] | None = None) -> Judgement:
    return judge(learnt(seed), NAMES, x, np.ones(x.shape, np.bool_) if valid is None else valid, SETTINGS)


def ridge(x: Array, target: int, left_out: tuple[int, ...]) -> float:
    """Residual of the last row's `target` by an ordinary ridge regression of the rows before on the other columns."""
    others = [i for i in range(x.shape[1]) if i not in left_out]
    rows, new = x[:-1], x[-1]
    penalty = 0.003 * len(rows)
    design = np.vstack([rows[:, others], np.sqrt(penalty) * np.eye(len(others))])
    weights = np.linalg.lstsq(design, np.concatenate([rows[:, target], np.zeros(len(others))]), rcond=None)[0]
    return float(new[target] - new[others] @ weights)


def test_leave_one_and_two_out_are_the_ridge_regressions_they_stand_for() -> None:
    draw = np.random.default_rng(5)
    x = draw.normal(size=(60, 3)) @ draw.normal(size=(3, 8)) + 0.2 * draw.normal(size=(60, 8))
    rows, new = x[:-1], x[-1:]
    precision = precision_of(rows.T @ rows / len(rows))
    residual, _ = leave_one_out(precision, new)
    mine, other, _ = leave_two_out(precision, new)
    for i in range(8):
        assert residual[0, i] == pytest.approx(ridge(x, i, (i,)), rel=1e-9)
        for j in range(8):
            if i != j:
                assert mine[0, i, j] == pytest.approx(ridge(x, i, (i, j)), rel=1e-9)
                assert other[0, i, j] == pytest.approx(ridge(x, j, (i, j)), rel=1e-9)


def test_leverage_is_that_of_the_other_inputs_alone() -> None:
    draw = np.random.default_rng(6)
    rows, new = draw.normal(size=(50, 5)), draw.normal(size=(1, 5))
    covariance = rows.T @ rows / len(rows)
    precision = precision_of(covariance)
    others = [1, 2, 3, 4]
    alone = new[0, others] @ precision_of(covariance[np.ix_(others, others)]) @ new[0, others]
    assert leave_one_out(precision, new)[1][0, 0] == pytest.approx(alone)
    rest = [2, 3, 4]
    alone = new[0, rest] @ precision_of(covariance[np.ix_(rest, rest)]) @ new[0, rest]
    assert leave_two_out(precision, new)[2][0, 0, 1] == pytest.approx(alone)


@pytest.mark.slow
def test_thresholds_are_students_quantile_and_markovs_bound() -> None:
    from scipy.stats import t as student  # a second that only this test needs to spend

    model = learnt(11)
    windows = 365.25 * 24 / 8
    assert model.offset_threshold == pytest.approx(1.3 * student.isf(0.5 / (29 * windows), 4 + 9))
    assert model.swap_threshold == pytest.approx(np.log(29 * 28 / 2 * windows))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_healthy_machine_gives_no_finding(seed: int) -> None:
    x = plant_days(seed)
    for end in range(3 * DAY + WINDOW, 5 * DAY, 72):
        assert judged(seed, x[end - WINDOW : end]).findings == ()


@pytest.mark.parametrize("seed", SEEDS)
def test_most_offsets_and_exchanges_are_found_and_named(seed: int) -> None:
    draw, x = np.random.default_rng(seed), plant_days(seed)
    offsets, swaps, runs = 0, 0, 20
    for _ in range(runs):
        end = int(draw.integers(3 * DAY + WINDOW, 5 * DAY))
        i, j = (int(v) for v in draw.choice(29, 2, replace=False))
        off, exchanged = x[end - WINDOW : end].copy(), x[end - WINDOW : end].copy()
        off[:, i] += 3.0
        exchanged[:, [i, j]] = exchanged[:, [j, i]]
        found = judged(seed, off).findings
        if found and found[0].kind == "offset" and NAMES[i] in found[0].inputs + found[0].alternatives:
            offsets += 1
            assert abs(found[0].offset_K) == pytest.approx(3.0, abs=1.5)
        found = judged(seed, exchanged).findings
        swaps += bool(found) and found[0].kind == "swap" and set(found[0].inputs) == {NAMES[i], NAMES[j]}
    assert offsets >= 0.75 * runs
    assert swaps >= 0.8 * runs


def test_what_a_window_would_not_show_is_said() -> None:
    """`alike` and `smallest_offset_K` against the faults themselves, on one window."""
    x = plant_days(12)[-WINDOW:]
    healthy = judged(12, x)
    for i in range(0, 29, 4):
        j = (i + 9) % 29
        exchanged = x.copy()
        exchanged[:, [i, j]] = exchanged[:, [j, i]]
        pair = (NAMES[min(i, j)], NAMES[max(i, j)])
        found = [set(f.inputs) for f in judged(12, exchanged).findings if f.kind == "swap"]
        assert (pair in healthy.alike) == (set(pair) not in found)
    for i in range(0, 29, 4):
        off = x.copy()
        off[:, i] += 3.0 * healthy.smallest_offset_K[NAMES[i]]
        assert NAMES[i] in {name for f in judged(12, off).findings for name in f.inputs + f.alternatives}


def test_two_faults_at_once() -> None:
    x = plant_days(13)[-WINDOW:].copy()
    i, j, off = NAMES.index("a_drive"), NAMES.index("bed_front_left"), NAMES.index("coolant_in")
    x[:, [i, j]] = x[:, [j, i]]
    x[:, off] += 6.0
    found = judged(13, x).findings
    assert {frozenset(f.inputs) for f in found if f.kind == "swap"} == {frozenset({"a_drive", "bed_front_left"})}
    assert "coolant_in" in {name for f in found if f.kind == "offset" for name in f.inputs + f.alternatives}


def test_a_dead_sensor_is_left_out_and_the_others_are_still_judged() -> None:
    x = plant_days(11)[-WINDOW:].copy()
    valid = np.ones(x.shape, np.bool_)
    valid[:, 7] = False
    x[:, 7] = np.nan
    x[:, 2] += 4.0
    judgement = judged(11, x, valid)
    assert NAMES[7] not in judgement.smallest_offset_K
    assert len(judgement.smallest_offset_K) == 28
    assert NAMES[2] in {name for f in judgement.findings for name in f.inputs + f.alternatives}


def test_too_little_is_not_learnt_from_and_not_judged() -> None:
    x = plant_days(11)
    valid = np.ones(x.shape, np.bool_)
    assert learn(NAMES, x[: 3 * 96 - 1], valid[: 3 * 96 - 1], SETTINGS) is None
    assert learn(NAMES[:2], x[:, :2], valid[:, :2], SETTINGS) is None
    assert learn(NAMES, x[:0], valid[:0], SETTINGS) is None
    assert judged(11, x[-50:]).smallest_offset_K == {}
    valid[-60:] = False
    assert judged(11, x[-WINDOW:], valid[-WINDOW:]).smallest_offset_K == {}


def test_a_machine_at_rest_is_not_judged() -> None:
    """When it is off for longer than was ever learnt, coolant and hall settle in a way that was never learnt."""
    still = np.tile(plant_days(11)[-1], (WINDOW, 1))
    still[:, 5] += 10.0
    assert judged(11, still) == Judgement()


def test_settings_and_shapes_are_checked() -> None:
    with pytest.raises(ValueError, match="window_steps = 5: expected 12 or more"):
        SensorCheckSettings(window_steps=5)
    with pytest.raises(ValueError, match="learn_steps = 100: expected 288 or more"):
        SensorCheckSettings(learn_steps=100)
    with pytest.raises(ValueError, match=r"inputs \(10, 3\), valid \(10, 3\): expected \(T, 29\), both"):
        learn(NAMES, np.zeros((10, 3)), np.ones((10, 3), np.bool_), SETTINGS)
