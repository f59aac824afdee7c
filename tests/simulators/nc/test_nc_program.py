"""The machine's day: reproducible, without gaps, and its integral equals a fine sum."""

import numpy as np
import pytest

from simulators.nc import Activity, DayPart, LoadCase, MeanLoads

DAY_S = 86400.0


def test_a_seed_gives_one_day() -> None:
    one, same, other = (LoadCase.random(seed, 3 * DAY_S) for seed in (5, 5, 6))
    assert one.blocks == same.blocks
    assert one.blocks != other.blocks


def test_blocks_last_five_minutes_to_two_hours_by_day() -> None:
    for seed in range(5):
        blocks = LoadCase.random(seed, 3 * DAY_S, start_hour=8.0).blocks
        lengths = [b.end_s - b.start_s for b in blocks if b.kind is not Activity.NIGHT]
        assert min(lengths) >= 300.0
        assert max(lengths) <= 7200.0
        assert all(length % 300.0 == 0.0 for length in lengths)


def test_every_kind_of_work_occurs_and_some_nights_are_quiet() -> None:
    blocks = LoadCase.random(3, 10 * DAY_S, start_hour=6.0).blocks
    assert {b.kind for b in blocks} == set(Activity)
    nights = [b for b in blocks if b.kind is Activity.NIGHT]
    assert 2 <= len(nights) <= 9
    for night in nights:
        begin_hour = (night.start_s / 3600.0 + 6.0) % 24.0
        assert 20.5 <= begin_hour <= 23.5
        assert 4.5 * 3600.0 <= night.end_s - night.start_s <= 8.5 * 3600.0


def test_one_axis_alone_loads_only_one() -> None:
    singles = [b for b in LoadCase.random(11, 10 * DAY_S).blocks if b.kind is Activity.SINGLE_AXIS]
    assert singles
    for block in singles:
        assert sum(v > 0 for v in block.loads.as_tuple()[:6]) == 1


def test_the_integral_is_what_a_fine_sum_gives() -> None:
    case = LoadCase.random(7, DAY_S)
    start, end = 1234.5, 40000.25
    times = np.linspace(start, end, 200_001)
    sampled = np.array([case.at(t).loads.as_tuple() for t in times])
    np.testing.assert_allclose(
        case.integral(end) - case.integral(start), np.trapezoid(sampled, times, axis=0), rtol=2e-4
    )


def test_safe_points_lie_between_operations_and_at_standstill() -> None:
    cut, rest = MeanLoads(x=1000.0), MeanLoads()
    case = LoadCase(
        [DayPart(0.0, 100.0, Activity.ROUGHING, cut), DayPart(100.0, 300.0, Activity.PAUSE, rest)], operation_s=40.0
    )
    points = [case.next_safe_point(t) for t in (0.0, 1.0, 40.0, 41.0, 81.0, 150.0, 1e4)]
    assert points == [0.0, 40.0, 40.0, 80.0, 100.0, 150.0, 1e4]


@pytest.mark.parametrize(
    "blocks",
    [
        [],
        [DayPart(10.0, 20.0, Activity.PAUSE, MeanLoads())],
        [DayPart(0.0, 10.0, Activity.PAUSE, MeanLoads()), DayPart(20.0, 30.0, Activity.PAUSE, MeanLoads())],
        [DayPart(0.0, 10.0, Activity.PAUSE, MeanLoads()), DayPart(10.0, 10.0, Activity.PAUSE, MeanLoads())],
    ],
)
def test_blocks_that_leave_gaps_are_not_a_day(blocks: list[DayPart]) -> None:
    with pytest.raises(ValueError, match="blocks"):
        LoadCase(blocks)
