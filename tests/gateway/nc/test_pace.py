"""A control that is too slow is reported once, and once more when it is quick again."""

import logging

import pytest

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


SLOW, QUICK = [1] * 5, [0] * 5
FLAPPING = (SLOW + QUICK) * 6


@pytest.mark.parametrize(
    ("skipped", "ended"),
    [
        ([0] * 20, []),
        ([1] * 4, []),
        ([1, 2, 3, 1, 1], [False]),
        ([1] * 4 + [0] + [1] * 4, []),
        ([1] * 4 + [0] + SLOW, [False]),
        ([1] * 20, [False]),
        (SLOW + [0] * 4 + [1] + [0] * 4, [False]),
        (SLOW + [0] * 20, [False, True]),
        (SLOW + QUICK + SLOW, [False, True, False]),
        (FLAPPING, [False, True] * 3 + [False]),
        (FLAPPING + [0] * round(60.0 / PERIOD_S), [False, True] * 4),
    ],
)
def test_five_slow_periods_in_a_row_begin_it_and_five_quick_ones_end_it(skipped: list[int], ended: list[bool]) -> None:
    assert [notice.ended for notice in told(*skipped)] == ended


def test_what_is_reported() -> None:
    begin, end = told(*SLOW, *QUICK)
    assert begin.subject == "pace of NC"
    assert begin.text.startswith("NC: a cycle of reading and writing takes longer than [nc] period_s = 0.5: ")
    assert end == Notice("pace of NC", plain("NC: cycles are within period_s again"), ended=True)
    assert "it is intermittent" in told(*FLAPPING)[6].text
