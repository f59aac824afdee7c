"""A control with frozen values is distinguished from a machine that stands still."""

from datetime import UTC, datetime

import pytest

from drivers.nc import NcSnapshot
from gateway.nc.motion import Motion


def snapshot(time_s: float, x: float, speed_x: float | None, y: float = 0.0) -> NcSnapshot:
    states = {} if speed_x is None else {"speed_X": speed_x}
    return NcSnapshot(datetime(2026, 1, 1, tzinfo=UTC), time_s, {"X": x, "Y": y}, states)


def test_an_axis_that_reports_a_speed_and_does_not_move_is_reported_after_its_time() -> None:
    motion = Motion(60.0)
    found = [motion.frozen(snapshot(t, 5.0, 100.0)) for t in (0.0, 15.0, 30.0, 45.0, 59.0, 60.0, 75.0)]
    assert found == [(), (), (), (), (), ("X",), ("X",)]
    assert motion.frozen(snapshot(76.0, 5.001, 100.0)) == ()
    assert motion.frozen(snapshot(90.0, 5.001, 100.0)) == ()


@pytest.mark.parametrize("speed", [0.0, None])
def test_a_machine_at_rest_or_of_unknown_speed_may_stand_without_limit(speed: float | None) -> None:
    motion = Motion(60.0)
    assert [motion.frozen(snapshot(t, 5.0, speed)) for t in (0.0, 1e3, 1e6)] == [(), (), ()]


def test_a_short_stop_starts_the_time_again() -> None:
    motion = Motion(60.0)
    for t in range(0, 105, 10):
        assert motion.frozen(snapshot(float(t), 5.0, 0.0 if t == 50 else 100.0)) == ()
    assert motion.frozen(snapshot(110.0, 5.0, 100.0)) == ("X",)


def test_a_machine_that_is_at_the_same_place_at_two_looks_far_apart_has_not_frozen() -> None:
    motion = Motion(60.0)
    assert [motion.frozen(snapshot(300.0 * n, 5.0, 100.0)) for n in range(10)] == [()] * 10


@pytest.mark.parametrize(("longest_s", "apart_s"), [(60.0, 16.0), (10.0, 2.6)])
def test_looks_more_than_a_quarter_of_the_time_apart_prove_nothing(longest_s: float, apart_s: float) -> None:
    motion = Motion(longest_s)
    assert [motion.frozen(snapshot(apart_s * n, 5.0, 100.0)) for n in range(10)] == [()] * 10


@pytest.mark.parametrize(("longest_s", "apart_s", "looks"), [(60.0, 15.0, 4), (10.0, 2.5, 4), (0.5, 0.125, 4)])
def test_looks_a_quarter_of_the_time_apart_do(longest_s: float, apart_s: float, looks: int) -> None:
    motion = Motion(longest_s)
    found = [motion.frozen(snapshot(apart_s * n, float("5.0"), 100.0)) for n in range(looks + 1)]  # equal, not the same
    assert found == [()] * looks + [("X",)]


@pytest.mark.parametrize("longest_s", [0.0, -1.0])
def test_an_impossible_time(longest_s: float) -> None:
    with pytest.raises(ValueError, match="longest_s"):
        Motion(longest_s)
