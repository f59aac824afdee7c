"""The component talc_errors of deploy/nc/linuxcnc: its C compiled alone, one call a servo period.

It is compared with the method's kinematics, and tried in every situation that must never make a step.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from talc import kinematics
from talc.frame import FloatArray
from tests.benches.servo_thread import ServoThread, offsets, size
from tests.benches.waits import turns

WARM = np.array([3.0, -88.8, 10.0, 4.0, 20.0, 12.6, 30.0, -25.0, 15.0])
RADIUS_MM, REACH_MM = 120.0, (300.0, 400.0)
SLEW_UM_PER_MS = 0.01


def random_poses(count: int, seed: int) -> FloatArray:
    """(count, 5) X Y Z in mm, A C in rad, within the reach."""
    rng = np.random.default_rng(seed)
    x, across, turn = rng.uniform(-300, 300, count), rng.uniform(0, 400, count), rng.uniform(0, 2 * math.pi, count)
    a, c = rng.uniform(-2.1, 2.1, count), rng.uniform(-7, 7, count)
    return np.column_stack([x, across * np.cos(turn), across * np.sin(turn), a, c])


def at_rest() -> ServoThread:
    thread = ServoThread(RADIUS_MM, REACH_MM)
    thread.input.tip[:], thread.input.a = (150.0, -80.0, 120.0), math.radians(30.0)
    return thread


def shift_at(thread: ServoThread, errors: FloatArray) -> FloatArray:
    where = np.array([*thread.input.tip, thread.input.a, 0.0])
    return kinematics.tcp_offsets(errors, where, RADIUS_MM * 1e-3)


def test_the_control_s_geometry_is_the_method_s() -> None:
    rng = np.random.default_rng(1)
    for pose in random_poses(500, 2):
        errors = rng.normal(0, 30, 9)
        theirs = kinematics.tcp_offsets(errors, pose, RADIUS_MM * 1e-3)
        assert offsets(errors, pose[:3], pose[3], RADIUS_MM) == pytest.approx(theirs, abs=1e-9)


def test_the_size_of_a_change_is_the_most_that_any_point_of_the_travel_can_move() -> None:
    largest = kinematics.largest_offsets((0.3, 0.4), 0.12)
    reached = np.zeros((3, 9))
    for pose in random_poses(3000, 3):
        reached = np.maximum(reached, np.abs(kinematics.offset_matrix(pose, 0.12)))
    assert (reached <= largest + 1e-12).all()
    assert (reached >= 0.9 * largest).all(), "and no more than that"
    rng = np.random.default_rng(4)
    for errors in (*np.eye(9), *rng.normal(0, 10, (200, 9))):
        expected = (largest @ np.abs(errors)).max()
        assert size(errors, RADIUS_MM, np.array(REACH_MM)) == pytest.approx(expected, rel=1e-12)


def test_the_errors_are_slewed_so_that_no_point_moves_faster_than_the_slew() -> None:
    thread = at_rest()
    thread.input.slew = thread.input.rate = 100.0
    thread.want(WARM)
    before, largest = thread.errors, kinematics.largest_offsets((0.3, 0.4), 0.12)
    periods = 0
    for _ in turns():
        thread.turn()
        moved = largest @ np.abs(thread.errors - before)
        assert moved.max() <= 0.1 * (1 + 1e-9)
        before, periods = thread.errors, periods + 1
        if np.array_equal(before, WARM):
            break
    assert periods * 0.1 == pytest.approx((largest @ np.abs(WARM)).max(), abs=0.11), "and not slower"
    assert thread.turn()[0] == pytest.approx(shift_at(thread, WARM), abs=1e-9)


def test_where_the_tool_is_counts_in_the_same_period() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    for pose in random_poses(200, 5):
        thread.input.tip[:], thread.input.a = pose[:3].tolist(), float(pose[3])
        there = np.clip(shift_at(thread, WARM), -200, 200)
        assert thread.turn()[0] == pytest.approx(there, abs=1e-9)


def test_no_offset_is_beyond_the_gateway_s_bound_nor_the_control_s() -> None:
    thread = at_rest()
    thread.input.bound[:] = (5.0, 40.0, 1000.0)
    thread.input.limit = 60.0
    thread.want(WARM * 3)
    thread.settle()
    for pose in random_poses(200, 6):
        thread.input.tip[:], thread.input.a = pose[:3].tolist(), float(pose[3])
        assert (np.abs(thread.turn()[0]) <= (5.0, 40.0, 60.0)).all()


def homes_again(thread: ServoThread) -> None:
    thread.input.homed = 0


def homed_elsewhere(thread: ServoThread) -> None:
    thread.input.homed = 1
    thread.input.tip[:] = (-300.0, 200.0, -100.0)


def longer_tool(thread: ServoThread) -> None:
    thread.input.tool[2] += 120.0
    thread.input.tip[2] -= 120.0


def narrower_bound(thread: ServoThread) -> None:
    thread.input.bound[:] = (2.0, 2.0, 2.0)


def ends_probing_elsewhere(thread: ServoThread) -> None:
    thread.input.hold = 1
    thread.turn()
    thread.input.tip[:], thread.input.a = (-250.0, 100.0, 300.0), -1.2
    assert np.ptp(thread.turn(50), axis=0).max() == 0.0
    thread.input.hold = 0


@pytest.mark.parametrize("event", [homes_again, longer_tool, narrower_bound, ends_probing_elsewhere])
def test_what_would_be_a_step_is_a_ramp_at_half_of_the_slew(event: Callable[[ServoThread], None]) -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    before = np.array(list(thread.state.out))
    event(thread)
    rows = np.vstack([before, thread.turn(60000)])
    assert np.abs(np.diff(rows, axis=0)).max() == pytest.approx(SLEW_UM_PER_MS / 2, rel=1e-9)
    end = shift_at(thread, WARM) * thread.input.homed
    assert rows[-1] == pytest.approx(np.clip(end, -thread.input.bound[0], thread.input.bound[0]), abs=1e-9)


def test_a_ramp_and_new_errors_together_keep_to_the_slew() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    rng = np.random.default_rng(7)
    last = np.array(list(thread.state.out))
    for _ in range(300):
        longer_tool(thread) if rng.random() < 0.5 else narrower_bound(thread)
        thread.input.tool[2] = float(rng.uniform(0, 150))
        thread.input.bound[:] = rng.uniform(1, 200, 3).tolist()
        thread.input.homed = int(rng.random() < 0.7)
        thread.input.hold = int(rng.random() < 0.2)
        thread.want(rng.normal(0, 30, 9))
        rows = np.vstack([last, thread.turn(20)])
        assert np.abs(np.diff(rows, axis=0)).max() <= SLEW_UM_PER_MS * (1 + 1e-6)
        last = rows[-1]


def test_nothing_is_in_force_before_homing_and_it_begins_at_zero() -> None:
    thread = at_rest()
    thread.input.homed = 0
    thread.want(WARM)
    assert np.abs(thread.turn(5000)).max() == 0.0
    homed_elsewhere(thread)
    rows = np.vstack([np.zeros(3), thread.turn(25000)])
    assert np.abs(np.diff(rows, axis=0)).max() <= SLEW_UM_PER_MS * (1 + 1e-9)
    assert rows[-1] == pytest.approx(shift_at(thread, WARM), abs=1e-9)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_moves_nothing(value: float) -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    before = np.array(list(thread.state.out))
    for field in ("wanted", "tip"):
        kept = getattr(thread.input, field)[1]
        getattr(thread.input, field)[1] = value
        assert (thread.turn(3) == before).all()
        getattr(thread.input, field)[1] = kept
        assert thread.turn()[0] == pytest.approx(before, abs=1e-12)


def test_a_rate_of_zero_holds_the_errors_while_the_tool_goes_on() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    thread.input.rate = 0.0
    thread.want(np.zeros(9))
    thread.input.tip[0] = -100.0
    assert thread.turn(100)[-1] == pytest.approx(shift_at(thread, WARM), abs=1e-9)
