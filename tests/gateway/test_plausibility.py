"""Stated limits of a channel."""

from datetime import UTC, datetime

from drivers.base import Quality, Reading
from gateway.plausibility import Check, Plausible


def judge(check: Check, value: float, at: float, quality: Quality = Quality.GOOD) -> Reading:
    return check.judge(Reading("a", value, "degC", quality, datetime(2026, 1, 1, tzinfo=UTC), at, 1))


def test_without_limits_nothing_is_judged() -> None:
    check = Check(Plausible())
    assert [judge(check, v, t).quality for t, v in enumerate((20.0, 900.0, 900.0))] == [Quality.GOOD] * 3


def test_range_names_value_and_limit() -> None:
    check = Check(Plausible(smallest=0.0, largest=60.0))
    assert judge(check, 60.0, 0.0).quality is Quality.GOOD
    hot = judge(check, 97.7, 1.0)  # what an open PTA8D08 input shows
    assert (hot.quality, hot.value) == (Quality.OUT_OF_RANGE, 97.7)
    assert "97.7" in hot.detail
    assert "60" in hot.detail
    assert judge(check, -0.1, 2.0).quality is Quality.OUT_OF_RANGE


def test_a_spike_is_refused_and_the_value_before_it_is_the_reference() -> None:
    check = Check(Plausible(rate_per_min=2.0))
    values = [20.0, 20.1, 35.0, 20.2]
    qualities = [judge(check, v, float(t)).quality for t, v in enumerate(values)]
    assert qualities == [Quality.GOOD, Quality.GOOD, Quality.OUT_OF_RANGE, Quality.GOOD]


def test_a_step_that_stays_is_accepted_when_the_rate_could_have_made_it() -> None:
    check = Check(Plausible(rate_per_min=2.0))
    judge(check, 20.0, 0.0)
    good_from = next(t for t in range(1, 1000) if judge(check, 30.0, float(t)).quality is Quality.GOOD)
    assert good_from == 300  # 10 K at 2 K/min


def test_one_step_of_resolution_is_no_rate() -> None:
    check = Check(Plausible(rate_per_min=0.5))
    assert judge(check, 20.0, 0.0).quality is Quality.GOOD
    assert judge(check, 20.1, 0.1).quality is Quality.GOOD


def test_a_frozen_value_turns_stale_and_recovers_with_the_first_change() -> None:
    check = Check(Plausible(stuck_after_s=60.0))
    qualities = [judge(check, 20.0, float(t)).quality for t in range(0, 80, 10)]
    assert qualities == [Quality.GOOD] * 6 + [Quality.STALE] * 2
    assert judge(check, 20.1, 80.0).quality is Quality.GOOD


def test_a_fault_passes_as_it_is() -> None:
    fault = judge(Check(Plausible(largest=60.0)), 200.0, 0.0, Quality.SENSOR_FAULT)
    assert (fault.quality, fault.detail) == (Quality.SENSOR_FAULT, "")
