"""Corrections from before the start of the page's program are asked of the gateway, page by page."""

from datetime import timedelta

import pytest

from gateway.listeners.web.older import MOST_TIMES
from gateway.telemetry.answers import CoursePage, StoredReason
from gateway.telemetry.messages import PublishedReason
from tests.benches.heard import BEGAN
from tests.benches.mill_page import mill_page
from tests.benches.stored_elsewhere import StoredElsewhere

HOUR = timedelta(hours=1)


def reason(estimate: float, *, trusted: bool = True) -> PublishedReason:
    return PublishedReason(estimate, trusted, 0.9, {"bed": estimate}, 0.0, 0.0, {"chosen inputs": 1.0}, 0.0, 1.0)


def stored() -> CoursePage:
    """Two times; at the second, one of two errors was corrected."""
    first = StoredReason((BEGAN - 2 * HOUR).isoformat(), 12, {"EZ0A": reason(3.0)}, {"EZ0A": 0.5}, None)
    second = StoredReason(
        (BEGAN - HOUR).isoformat(), 24, {"EZ0A": reason(4.0), "EX0C": reason(1.0, trusted=False)}, {}, BEGAN.isoformat()
    )
    return CoursePage([], {}, [], {}, reasons=[first, second])


def test_the_newest_line_comes_first_and_the_next_answer_goes_on_before_the_oldest() -> None:
    source = StoredElsewhere(stored)
    found = mill_page(source, heard=True).get("/corrections/mill", params={"before": BEGAN.isoformat()}).json()
    assert [(line["k"], line["error"], line["estimate"]["n"]) for line in found["lines"]] == [
        (24, "EZ0A", 4.0),
        (12, "EZ0A", 3.0),
    ]
    assert [line["measured"] for line in found["lines"]] == [BEGAN.isoformat(), None]
    assert found["lines"][0]["half"]["n"] is None
    assert found["lines"][1]["half"]["n"] == pytest.approx(0.98)
    assert (found["before"], found["why"]) == ((BEGAN - 2 * HOUR).isoformat(), None)
    ((machine, begin, end, most),) = source.asked
    assert (machine, end, most) == ("mill", BEGAN, MOST_TIMES)
    assert end - begin > timedelta(days=180)


def test_a_page_that_has_no_line_yet_begins_at_the_gateways_present() -> None:
    source = StoredElsewhere(stored)
    assert len(mill_page(source, heard=True).get("/corrections/mill").json()["lines"]) == 2
    assert source.asked[0][2] == BEGAN


def test_where_nothing_older_is_stored_there_is_no_next_answer() -> None:
    found = mill_page(StoredElsewhere(lambda: CoursePage([], {}, [], {})), heard=True).get("/corrections/mill").json()
    assert found == {"lines": [], "before": None, "why": None}


def test_a_gateway_that_does_not_answer_is_reported_and_so_is_one_that_was_never_heard() -> None:
    def silent() -> CoursePage:
        raise OSError("no answer within 5 s")

    found = mill_page(StoredElsewhere(silent), heard=True).get("/corrections/mill").json()
    assert found["why"]["s"] == "no answer within 5 s"
    unheard = mill_page(StoredElsewhere(stored)).get("/corrections/mill").json()
    assert unheard["why"]["say"] == "page.nothing_heard"


@pytest.mark.parametrize("before", ["yesterday", "0001-01-01T00:00:00+00:00", "9999-12-31T23:59:59-14:00"])
def test_an_invalid_time_is_refused_and_nobody_asked(before: str) -> None:
    source = StoredElsewhere(stored)
    assert mill_page(source, heard=True).get("/corrections/mill", params={"before": before}).status_code == 400
    assert mill_page(source, heard=True).get("/corrections/no%20machine").status_code == 404
    assert source.asked == []
