"""Another master on a line is reported once when it is heard and once when it is not any more."""

import logging

from gateway.acquisition.line import Line
from gateway.acquisition.reports import LineReports
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.runtime.problems import Problems
from tests.benches.scripted_bus import ScriptedBus
from tests.benches.stepped_clock import SteppedClock


class OverhearingBus(ScriptedBus):
    """A bus whose line others use."""

    evidence = ""

    def other_master(self) -> str:
        return self.evidence


def test_it_is_a_problem_of_the_line_and_not_of_its_devices() -> None:
    notices: list[Notice] = []
    bus = OverhearingBus()
    problems = Problems(SteppedClock(), 1.0, notices.append, logging.getLogger(__name__))
    reports = LineReports(Line(bus, ()), problems)
    for evidence in ("", "3 frames", "4 frames", "", ""):
        bus.evidence = evidence
        reports.polled({}, 0)
    assert [(notice.subject, notice.ended, notice.code, dict(notice.values)) for notice in notices] == [
        ("line of bus rtu1", False, NoticeCode.OTHER_MASTER, {"bus": "rtu1", "evidence": "3 frames"}),
        ("line of bus rtu1", True, NoticeCode.NO_OTHER_MASTER, {"bus": "rtu1"}),
    ]
