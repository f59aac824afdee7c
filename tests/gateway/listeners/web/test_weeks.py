"""The scatter of touches by week, from what a gateway has stored."""

import json
from datetime import UTC, datetime, timedelta

import pytest

from gateway.listeners.web.weeks import scatter_by_week
from gateway.telemetry.answers import CoursePage
from tests.benches.heard import BEGAN
from tests.benches.mill_page import mill_page
from tests.benches.stored_elsewhere import StoredElsewhere

MONDAY = datetime(2026, 1, 5, tzinfo=UTC)
DAY = timedelta(days=1)


def stored(*found: tuple[datetime, float | None]) -> CoursePage:
    return CoursePage([], {}, [at.timestamp() for at, _ in found], {}, [residual for _, residual in found])


def test_weeks_begin_on_monday_and_the_latest_comes_first() -> None:
    weeks = scatter_by_week(
        stored(
            (MONDAY - timedelta(seconds=1), 5.0),
            (MONDAY, 1.0),
            (MONDAY + DAY, 2.0),
            (MONDAY + 2 * DAY, None),
            (MONDAY + 7 * DAY - timedelta(seconds=1), 9.0),
            (MONDAY + 21 * DAY, float("inf")),
        )
    )
    shown = [(week.t, week.n.n, week.median.n, week.most.n) for week in weeks]
    assert shown == [
        (MONDAY.timestamp(), 3, 2.0, 9.0),
        ((MONDAY - 7 * DAY).timestamp(), 1, 5.0, 5.0),
    ]


@pytest.mark.parametrize("page", [CoursePage([], {}, [1e9], {}), CoursePage([], {}, [1e30], {}, [1.0])])
def test_columns_of_other_lengths_and_invalid_times_are_refused(page: CoursePage) -> None:
    with pytest.raises(ValueError, match=r"residuals of|is not a time"):
        scatter_by_week(page)


def test_the_page_asks_for_the_last_twelve_weeks_of_the_gateways_time() -> None:
    source = StoredElsewhere(lambda: stored((MONDAY, 1.0)))
    answer = mill_page(source, heard=True).get("/scatter/mill")
    shown = json.loads(answer.content)
    assert ([week["n"]["n"] for week in shown["weeks"]], shown["why"]) == ([1], None)
    assert source.asked == [("mill", BEGAN - timedelta(weeks=12), BEGAN, 2000)]


def test_what_the_gateway_says_when_it_cannot_is_passed_on() -> None:
    def refuse() -> CoursePage:
        raise OSError("course: this gateway has no store")

    answer = mill_page(StoredElsewhere(refuse), heard=True).get("/scatter/mill")
    assert answer.json() == {"weeks": None, "why": {"s": "course: this gateway has no store"}}
    source = StoredElsewhere(refuse)
    unheard = mill_page(source).get("/scatter/mill").json()
    assert unheard == {"weeks": None, "why": {"say": "page.nothing_heard", "values": {}}}
    assert mill_page(source, heard=True).get("/scatter/a%20b").status_code == 404
    assert source.asked == []
