"""A control that is too slow is reported once, and once more when it is quick again."""

import logging

from gateway.model.notice import Notice
from gateway.model.text import plain
from gateway.nc.pace import NcPace
from gateway.runtime.problems import Problems
from tests.benches.stepped_clock import SteppedClock

PERIOD_S = 0.5


def told(*skipped: int) -> list[Notice]:
    """What a series of periods reports."""
    notices: list[Notice] = []
    clock = SteppedClock()
    pace = NcPace(PERIOD_S, Problems(clock, PERIOD_S, notices.append, logging.getLogger(__name__)))
    for each in skipped:
        clock.spend(PERIOD_S)
        pace.worked(each)
    return notices


def test_five_slow_periods_in_a_row_are_reported_and_four_are_not() -> None:
    assert told(1, 1, 1, 1) == []
    (notice,) = told(1, 2, 3, 1, 1)
    assert notice.subject == "pace of NC"
    assert notice.text.startswith("NC: a cycle of reading and writing takes longer than [nc] period_s = 0.5: ")
    assert not notice.ended


def test_a_quick_period_starts_the_count_again() -> None:
    assert told(1, 1, 1, 1, 0, 1, 1, 1, 1) == []
    assert len(told(1, 1, 1, 1, 0, 1, 1, 1, 1, 1)) == 1


def test_while_it_stays_slow_nothing_more_is_reported() -> None:
    assert len(told(*[1] * 20)) == 1


def test_five_quick_periods_in_a_row_end_it() -> None:
    assert len(told(*[1] * 5, *[0] * 4, 1, *[0] * 4)) == 1
    begin, end = told(*[1] * 5, *[0] * 4, 1, *[0] * 5)
    assert not begin.ended
    assert end == Notice("pace of NC", plain("NC: cycles are within period_s again"), ended=True)
    assert len(told(*[1] * 5, *[0] * 20)) == 2


def test_it_may_begin_again() -> None:
    assert [notice.ended for notice in told(*[1] * 5, *[0] * 5, *[1] * 5)] == [False, True, False]


def test_one_that_is_slow_again_and_again_is_intermittent_until_it_has_been_quick_for_a_minute() -> None:
    flapping = ([1] * 5 + [0] * 5) * 6
    notices = told(*flapping, *[0] * round(60.0 / PERIOD_S))
    assert [notice.ended for notice in notices] == [False, True] * 4
    assert "it is intermittent" in notices[6].text
    assert len(told(*flapping)) == 7, "until then nothing more"


def test_a_quick_control_is_never_reported() -> None:
    assert told(*[0] * 20) == []
