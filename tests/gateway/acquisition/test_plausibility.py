"""Stated limits of a channel."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import Quality, Reading
from gateway.acquisition.plausibility import Check
from gateway.config.sections import Limits
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


def judge(check: Check, value: float, at: float, quality: Quality = Quality.GOOD) -> Reading:
    return check.judge(Reading("a", value, "degC", quality, datetime(2026, 1, 1, tzinfo=UTC), at))


def test_without_limits_nothing_is_judged() -> None:
    check = Check(Limits())
    assert [judge(check, v, t).quality for t, v in enumerate((20.0, 900.0, 900.0))] == [Quality.GOOD] * 3


def test_range_names_value_and_limit() -> None:
    check = Check(Limits(min=0.0, max=60.0))
    assert judge(check, 60.0, 0.0).quality is Quality.GOOD
    hot = judge(check, 97.7, 1.0)  # what an open PTA8D08 input shows
    assert (hot.quality, hot.value) == (Quality.OUT_OF_RANGE, 97.7)
    assert "97.7" in hot.detail
    assert "60" in hot.detail
    assert judge(check, -0.1, 2.0).quality is Quality.OUT_OF_RANGE


def test_a_spike_is_refused_and_the_value_before_it_is_the_reference() -> None:
    check = Check(Limits(max_rate_per_min=2.0))
    values = [20.0, 20.1, 35.0, 20.2]
    qualities = [judge(check, v, float(t)).quality for t, v in enumerate(values)]
    assert qualities == [Quality.GOOD, Quality.GOOD, Quality.OUT_OF_RANGE, Quality.GOOD]


@given(st.lists(st.floats(-0.4, 0.4), min_size=6, max_size=30), st.data(), st.floats(1.5, 1e6) | st.floats(-1e6, -1.5))
def test_a_lone_spike_is_refused_whatever_its_size_and_nothing_else(
    steps: list[float], data: st.DataObject, size: float
) -> None:
    values = [20.0 + sum(steps[:i]) / len(steps) for i in range(len(steps))]
    at = data.draw(st.integers(1, len(values) - 1))
    values[at] += size
    check = Check(Limits(max_jump=1.0))
    refused = [i for i, value in enumerate(values) if judge(check, value, float(i)).quality is not Quality.GOOD]
    assert refused == [at]


def test_a_step_is_no_spike_and_is_taken_with_the_next_reading_that_agrees() -> None:
    check = Check(Limits(max_jump=1.0))
    values = [20.0, 20.1, 35.0, 35.2, 35.1, 50.0, 65.0, 65.5]
    readings = [judge(check, value, float(t)) for t, value in enumerate(values)]
    good = [reading.quality is Quality.GOOD for reading in readings]
    assert good == [True, True, False, True, True, False, False, True]
    assert isinstance(detail := readings[2].detail, Text)
    assert (detail.code, detail.values) == (NoticeCode.JUMPED, {"by": pytest.approx(14.9), "most": 1.0})


def test_a_spike_that_is_read_again_is_still_one_measurement() -> None:
    """A topic or frame may come less often than it is read; its age is computed again each time, to a millisecond."""
    check = Check(Limits(max_jump=1.0))
    measured = [(20.0, 0.0), (35.0, 10.0), (20.1, 20.0), (35.0, 30.0), (35.2, 40.0)]
    good = [[judge(check, value, at + i / 1000).quality is Quality.GOOD for i in range(9)] for value, at in measured]
    assert good == [[True] * 9, [False] * 9, [True] * 9, [False] * 9, [True] * 9]


def test_a_step_is_taken_however_often_it_is_measured() -> None:
    check = Check(Limits(max_jump=1.0))
    good = [judge(check, value, i / 100).quality is Quality.GOOD for i, value in enumerate([20.0, *[35.0] * 20])]
    assert (good[0], good[1], good[-1]) == (True, False, True)


def test_a_spike_beside_a_rate_does_not_become_its_reference() -> None:
    check = Check(Limits(max_jump=5.0, max_rate_per_min=2.0))
    values = [20.0, 80.0, 20.1, 23.0, 23.0]
    good = [judge(check, value, float(t)).quality is Quality.GOOD for t, value in enumerate(values)]
    assert good == [True, False, True, False, False]


def test_a_step_that_stays_is_accepted_when_the_rate_could_have_made_it() -> None:
    check = Check(Limits(max_rate_per_min=2.0))
    judge(check, 20.0, 0.0)
    good_from = next(t for t in range(1, 1000) if judge(check, 30.0, float(t)).quality is Quality.GOOD)
    assert good_from == 300  # 10 K at 2 K/min


def test_a_rate_is_judged_against_the_last_value_that_was_plausible_and_not_the_first() -> None:
    check = Check(Limits(max_rate_per_min=2.0))
    slow = [judge(check, 20.0 + minute, 60.0 * minute).quality for minute in range(11)]  # 1 K/min
    assert set(slow) == {Quality.GOOD}
    assert judge(check, 38.0, 660.0).quality is Quality.OUT_OF_RANGE, "8 K within the last minute"


def test_one_step_of_resolution_is_no_rate() -> None:
    check = Check(Limits(max_rate_per_min=0.5))
    assert judge(check, 20.0, 0.0).quality is Quality.GOOD
    assert judge(check, 20.1, 0.1).quality is Quality.GOOD


def test_a_frozen_value_turns_stale_and_recovers_with_the_first_change() -> None:
    check = Check(Limits(stuck_after_s=60.0))
    qualities = [judge(check, 20.0, float(t)).quality for t in range(0, 80, 10)]
    assert qualities == [Quality.GOOD] * 6 + [Quality.STALE] * 2
    assert judge(check, 20.1, 80.0).quality is Quality.GOOD


def test_a_fault_passes_as_it_is() -> None:
    fault = judge(Check(Limits(max=60.0)), 200.0, 0.0, Quality.SENSOR_FAULT)
    assert (fault.quality, fault.detail) == (Quality.SENSOR_FAULT, "")
