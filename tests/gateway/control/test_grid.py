"""From readings to frames, and the numbering of grid instants."""

import math
import tracemalloc
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import Quality, Reading
from gateway.control.grid import GridSampler, Instant, Schedule
from talc.frame import Measurement

UTC_0 = datetime(2026, 3, 2, 6, 2, 10, tzinfo=UTC)  # 130 s into a step
K_0 = int(datetime(2026, 3, 2, 6, 0, tzinfo=UTC).timestamp()) // 300


def reading(channel: str, value: float, at: float, quality: Quality = Quality.GOOD) -> Reading:
    return Reading(channel, value, "degC", quality, UTC_0 + timedelta(seconds=at), at)


def test_an_input_is_the_mean_of_its_good_readings() -> None:
    sampler = GridSampler(("a", "b", "c"), 300.0)
    sampler.add([reading("a", 20.0, 10.0), reading("a", 21.0, 20.0), reading("a", 99.0, 30.0, Quality.OUT_OF_RANGE)])
    sampler.add([reading("b", math.nan, 10.0, Quality.COMM_FAULT), reading("stranger", 1.0, 10.0)])
    sampler.add([reading("c", math.nan, 10.0)])
    measurement = Measurement(np.arange(9.0), np.ones(9))
    frame = sampler.frame(Instant(7, 300.0), measurement)
    assert frame.k == 7
    assert frame.inputs[0] == 20.5
    assert frame.valid.tolist() == [True, False, False]
    assert np.isnan(frame.inputs[1:]).all()
    assert frame.measurement is measurement


def test_a_state_becomes_its_share_of_the_step() -> None:
    sampler = GridSampler(("coolant",), 300.0)
    for second in range(0, 300, 60):
        sampler.add_states({"coolant": 1.0 if second < 60 else 0.0, "other": 5.0}, float(second + 1))
    assert sampler.frame(Instant(1, 300.0)).inputs[0] == pytest.approx(0.2)


def test_what_comes_after_the_instant_belongs_to_the_next_frame() -> None:
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", 20.0, 300.0), reading("a", 30.0, 300.1)])
    assert sampler.frame(Instant(1, 300.0)).inputs[0] == 20.0
    assert sampler.frame(Instant(2, 600.0)).inputs[0] == 30.0
    assert not sampler.frame(Instant(3, 900.0)).valid.any()


def test_readings_older_than_a_step_do_not_enter_a_late_frame() -> None:
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", 10.0, 50.0), reading("a", 20.0, 1150.0)])
    assert sampler.frame(Instant(4, 1200.0)).inputs[0] == 20.0


def test_a_reading_that_arrives_after_the_frame_of_its_step_is_dropped() -> None:
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", 20.0, 200.0)])
    assert sampler.frame(Instant(1, 300.0)).inputs.tolist() == [20.0]
    sampler.add([reading("a", 99.0, 300.0), reading("a", 21.0, 301.0)])
    assert sampler.present(330.0)[0].tolist() == [20.5]
    assert sampler.frame(Instant(2, 600.0)).inputs.tolist() == [21.0]


def test_present_inputs_are_means_of_two_fifths_of_a_step_whatever_frame_came_between() -> None:
    sampler = GridSampler(("a", "b", "c"), 300.0)
    sampler.add([reading("a", 20.0, 190.0), reading("b", 5.0, 10.0)])
    values, valid = sampler.present(210.0)
    assert values[:2].tolist() == [20.0, 5.0]
    assert valid.tolist() == [True, True, False]
    sampler.add([reading("a", 22.0, 290.0), reading("b", 6.0, 295.0)])
    assert sampler.frame(Instant(1, 300.0)).inputs[:2].tolist() == [21.0, 5.5]
    sampler.add([reading("a", 27.0, 330.0), reading("a", 99.0, 331.0)])
    values, valid = sampler.present(330.0)
    assert values[:2].tolist() == [24.5, 6.0], "22 and 27: what was read at 190 s is too old, and 331 s is not yet"
    assert valid.tolist() == [True, True, False]


def test_an_input_that_is_read_less_often_is_the_mean_of_a_step_and_then_not_valid() -> None:
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", 20.0, 60.0), reading("a", 22.0, 110.0)])
    sampler.present(60.0)
    sampler.present(120.0)
    sampler.frame(Instant(1, 300.0))
    for now_s, mean in ((350.0, 21.0), (390.0, 22.0)):
        values, valid = sampler.present(now_s)
        assert values.tolist() == [mean]
        assert valid.tolist() == [True]
    assert sampler.present(450.0)[1].tolist() == [False]


def test_a_frame_less_than_a_step_after_the_last_one_has_its_own_readings_only() -> None:
    """The grid was anchored again, because the clock was set."""
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", 20.0, 190.0), reading("a", 21.0, 350.0)])
    sampler.present(210.0)
    assert sampler.frame(Instant(1, 300.0)).inputs.tolist() == [20.0]
    assert sampler.frame(Instant(2, 400.0)).inputs.tolist() == [21.0]


@pytest.mark.slow
def test_looking_at_the_present_for_weeks_takes_no_more_memory() -> None:
    sampler, held = GridSampler(("a",), 300.0), []
    tracemalloc.start()
    try:
        for step in range(1, 501):
            for part in range(1, 11):
                sampler.present(300.0 * step - 300.0 + 30.0 * part)
            sampler.frame(Instant(step, 300.0 * step))
            if step in (100, 500):
                held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert held[1] < held[0] + 50_000


@given(
    st.lists(st.tuples(st.floats(0.0, 900.0), st.floats(-50.0, 100.0)), max_size=40),
    st.lists(st.floats(0.0, 900.0), max_size=12),
)
def test_a_frame_is_the_same_whether_or_not_somebody_has_looked_at_the_present(
    samples: list[tuple[float, float]], looks: list[float]
) -> None:
    alone, looked_at = GridSampler(("a",), 300.0), GridSampler(("a",), 300.0)
    happens = sorted([(at, 0, value) for at, value in samples] + [(at, 1, 0.0) for at in looks])
    for k, end in enumerate((300.0, 600.0, 900.0), start=1):
        for at, kind, value in happens:
            if not end - 300.0 < at <= end:
                continue
            if kind:
                looked_at.present(at)
            else:
                alone.add([reading("a", value, at)])
                looked_at.add([reading("a", value, at)])
        expected, found = alone.frame(Instant(k, end)), looked_at.frame(Instant(k, end))
        assert found.valid.tolist() == expected.valid.tolist()
        assert found.inputs == pytest.approx(expected.inputs, nan_ok=True)


@given(st.lists(st.floats(-50, 100), min_size=1, max_size=50))
def test_the_mean_lies_between_the_readings(values: list[float]) -> None:
    sampler = GridSampler(("a",), 300.0)
    sampler.add([reading("a", value, float(i)) for i, value in enumerate(values, start=1)])
    found = float(sampler.frame(Instant(1, 300.0)).inputs[0])
    assert min(values) - 1e-9 <= found <= max(values) + 1e-9


def test_instants_lie_on_utc_and_do_not_drift() -> None:
    schedule = Schedule(300.0)
    mono = 5.0
    for step in range(1, 2000):
        instant = schedule.next(UTC_0 + timedelta(seconds=mono - 5.0), mono)
        assert instant.k == K_0 + step
        assert instant.monotonic_s == pytest.approx(5.0 + 170.0 + 300.0 * (step - 1), abs=1e-5)
        mono = instant.monotonic_s + 0.001 * (step % 7)  # waking is late by some milliseconds


def test_waking_a_hair_early_does_not_repeat_or_skip() -> None:
    schedule = Schedule(300.0)
    first = schedule.next(UTC_0, 0.0)
    early = math.nextafter(first.monotonic_s, 0.0)
    second = schedule.next(UTC_0 + timedelta(seconds=early), early)
    assert second.k == first.k + 1
    assert second.monotonic_s == pytest.approx(first.monotonic_s + 300.0, abs=1e-5)


def test_a_restart_goes_on_with_the_index() -> None:
    before = Schedule(300.0).next(UTC_0, 1000.0)
    after = Schedule(300.0, last_k=before.k).next(UTC_0 + timedelta(seconds=3600), 3.0)
    assert after.k == before.k + 12


def test_a_late_wake_leaves_a_gap() -> None:
    schedule = Schedule(300.0)
    first = schedule.next(UTC_0, 0.0)
    late = schedule.next(UTC_0 + timedelta(seconds=1000), 1000.0)
    assert late.k == first.k + 3
    assert late.monotonic_s > 1000.0


@pytest.mark.parametrize("jump_h", [-1, 1])
def test_a_clock_that_jumps_keeps_the_index_rising_and_the_step_whole(jump_h: int) -> None:
    schedule = Schedule(300.0)
    instants = []
    mono, shift = 0.0, timedelta()
    for step in range(20):
        if step == 10:
            shift = timedelta(hours=jump_h)
        instants.append(schedule.next(UTC_0 + timedelta(seconds=mono) + shift, mono))
        mono = instants[-1].monotonic_s
    ks = [instant.k for instant in instants]
    assert all(b > a for a, b in pairwise(ks))
    assert [i for i in range(20) if instants[i].clock_moved_s] == [10]
    assert instants[10].clock_moved_s == pytest.approx(3600 * jump_h)
    assert ks[10] - ks[9] == (13 if jump_h > 0 else 1)
    gaps = np.diff([instant.monotonic_s for instant in instants])
    assert gaps == pytest.approx(300.0, abs=1e-5)


def test_with_a_clock_behind_the_stored_steps_numbering_continues_from_them() -> None:
    schedule = Schedule(300.0, last_k=K_0 + 100)
    assert [schedule.next(UTC_0 + timedelta(seconds=s), s).k for s in (0.0, 200.0, 500.0)] == [
        K_0 + 101,
        K_0 + 102,
        K_0 + 103,
    ]


def test_a_restart_within_a_moment_of_a_step_gives_the_numbering_no_lead() -> None:
    """The clock was slewed back by a second since the last step."""
    first = Schedule(300.0, K_0 + 1).next(UTC_0 + timedelta(seconds=169.0), 0.0)
    assert (first.k, first.lead_s) == (K_0 + 2, 0.0)
    assert first.monotonic_s == pytest.approx(301.0)


def test_a_clock_that_is_set_back_gives_the_numbering_a_lead_that_a_restart_keeps() -> None:
    schedule = Schedule(300.0)
    before = schedule.next(UTC_0, 0.0)
    back = UTC_0 - timedelta(days=8)
    after = schedule.next(back + timedelta(seconds=200.0), 200.0)
    assert (after.k, after.lead_s) == (before.k + 1, 8 * 86400.0)
    restarted = Schedule(300.0, after.k, after.lead_s).next(back + timedelta(seconds=3600.0), 7.0)
    assert restarted.k == before.k + 12
