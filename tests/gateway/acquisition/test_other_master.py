"""Another master on a line is reported once when it is heard and once when it is not any more."""

import logging

from gateway.model.text import plain
from gateway.acquisition.line import Line
from gateway.acquisition.reports import LineReports
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
    assert notices == [
        Notice(
            "line of bus rtu1",
            "bus rtu1: another master is on this line: 3 frames (only one may ask; end the other, or connect it to"
            " another line)",
        ),
        Notice("line of bus rtu1", plain("bus rtu1: no other master is heard any more"), ended=True),
    ]
