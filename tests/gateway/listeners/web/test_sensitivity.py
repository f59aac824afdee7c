"""Micrometres per kelvin by week, from what a gateway has stored."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from gateway.listeners.web.sensitivity import sensitivity_by_week
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.messages import PublishedCourse
from talc.frame import FloatArray
from talc.names import THERMAL_ERRORS
from tests.benches.heard import BEGAN
from tests.benches.mill_page import mill_page
from tests.benches.stored_elsewhere import StoredElsewhere

MONDAY_S = datetime(2026, 1, 5, tzinfo=UTC).timestamp()
HOUR_S, WEEK_S = 3600.0, 7 * 86400.0


def stored(times: FloatArray, errors: dict[str, FloatArray], **temperatures: FloatArray) -> CoursePage:
    nothing: FloatArray = np.zeros(len(times))

    def column(values: FloatArray) -> list[float | None]:
        return [v if math.isfinite(v) else None for v in values.tolist()]

    published = {e: PublishedCourse(column(errors.get(e, nothing)), column(nothing)) for e in THERMAL_ERRORS}
    return CoursePage(times.tolist(), published, [], {}, [], {n: column(t) for n, t in temperatures.items()})


def hours(n: float, begin_s: float = MONDAY_S) -> FloatArray:
    return np.asarray(begin_s + np.arange(0.0, n) * HOUR_S)


def daily(times: FloatArray, late_h: float = 0.0) -> FloatArray:
    return np.asarray(20.0 + 5.0 * np.sin(2.0 * np.pi * (times - late_h * HOUR_S) / 86400.0))


def test_each_week_has_the_slope_of_its_own_line_and_the_latest_comes_first() -> None:
    t = hours(2 * 168)
    bed = daily(t)
    slope = np.where(t < MONDAY_S + WEEK_S, 2.0, -3.0)
    found = sensitivity_by_week(stored(t, {"EX0C": slope * bed + 100.0, "EB0C": 0.5 * bed}, bed=bed))
    assert found.weeks == [MONDAY_S + WEEK_S, MONDAY_S]
    told = [(e.error, e.temperature, e.unit) for e in found.errors]
    assert told == [("EX0C", "bed", "µm/K"), ("EB0C", "bed", "µm/m/K")], "what hardly changes has no sensitivity"
    slopes = [s.n for e in found.errors for s in e.slopes]
    assert slopes == pytest.approx([-3.0, 2.0, 0.5, 0.5])
    assert [e.follows.n for e in found.errors] == pytest.approx([100.0, 100.0])


def test_the_temperature_is_that_which_explains_most_and_a_sine_that_comes_late_explains_half() -> None:
    """A sine 45° late: slope cos 45°, share cos² 45°."""
    t = hours(168)
    error = 4.0 * daily(t)
    found = sensitivity_by_week(stored(t, {"EZ0A": error}, bed=daily(t, 6.0), spindle=daily(t, 3.0)))
    (shown,) = found.errors
    assert shown.temperature == "spindle"
    assert shown.follows.n == pytest.approx(50.0, abs=0.5)
    assert shown.slopes[0].n == pytest.approx(4.0 * math.cos(math.pi / 4), abs=0.02)


def test_the_slope_is_that_of_a_least_squares_fit_where_values_are_missing() -> None:
    rng = np.random.default_rng(5)
    t = hours(120)
    bed, noise = daily(t), rng.normal(0.0, 2.0, len(t))
    error = 2.0 * bed + noise
    bed_seen, error_seen = np.where(rng.random(len(t)) < 0.2, np.nan, bed), np.where(t % 7 == 0, np.nan, error)
    (shown,) = sensitivity_by_week(stored(t, {"EY0C": error_seen}, bed=bed_seen)).errors
    both = np.isfinite(bed_seen) & np.isfinite(error_seen)
    assert shown.slopes[0].n == pytest.approx(np.polyfit(bed_seen[both], error_seen[both], 1)[0])


@pytest.mark.parametrize(
    ("n", "swing", "gain"),
    [(11, 1.0, 1.0), (168, 0.05, 100.0), (168, 1.0, 0.01), (168, 0.0, 0.0)],
    ids=["half a day", "the temperature stays", "the error stays", "nothing moves"],
)
def test_a_week_without_enough_changes_has_no_slope(n: int, swing: float, gain: float) -> None:
    t = hours(n)
    bed = 20.0 + swing * (daily(t) - 20.0)
    assert sensitivity_by_week(stored(t, {"EX0C": gain * bed}, bed=bed)).errors == []
    assert sensitivity_by_week(stored(t, {"EX0C": daily(t)})).errors == []
    assert sensitivity_by_week(CoursePage([], {}, [], {}, [], {"bed": []})).weeks == []


def test_a_week_in_which_the_temperature_failed_has_none_and_the_others_have() -> None:
    t = hours(2 * 168)
    bed = daily(t)
    failed = np.where(t < MONDAY_S + WEEK_S, np.nan, bed)
    (shown,) = sensitivity_by_week(stored(t, {"EX0C": 2.0 * bed}, bed=failed)).errors
    assert [s.n for s in shown.slopes] == [pytest.approx(2.0), None]
    assert shown.follows.n == pytest.approx(100.0), "of what could be compared"


@pytest.mark.parametrize(
    "page",
    [
        CoursePage([1e9], {}, [], {}, [], {"bed": []}),
        CoursePage([1e30], {}, [], {}, [], {"bed": [1.0]}),
        CoursePage([1e9], {"EX0C": PublishedCourse([], [])}, [], {}, [], {"bed": [1.0]}),
    ],
)
def test_columns_of_other_lengths_and_invalid_times_are_refused(page: CoursePage) -> None:
    with pytest.raises(ValueError, match=r"temperatures for|is not a time|numbers for"):
        sensitivity_by_week(page)


def test_the_page_asks_for_twelve_weeks_with_temperatures_and_passes_on_a_refusal() -> None:
    t = hours(168)
    source = StoredElsewhere(lambda: stored(t, {"EX0C": 2.0 * daily(t)}, bed=daily(t)))
    answer = mill_page(source, heard=True).get("/sensitivity/mill").json()
    assert [e["error"] for e in answer["errors"]] == ["EX0C"]
    assert source.asked == [("mill", BEGAN - timedelta(weeks=12), BEGAN, 1000)]

    def refuse() -> CoursePage:
        raise OSError("course: temperatures: unknown; expected one of from, to, limit")

    refused = mill_page(StoredElsewhere(refuse), heard=True).get("/sensitivity/mill").json()
    assert refused == {
        "weeks": None, "errors": [], "why": {"s": "course: temperatures: unknown; expected one of from, to, limit"},
    }  # fmt: skip
