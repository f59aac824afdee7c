"""Hours of random faults and restarts; and that the soak excuses no alarm that a fault does not explain.

More of it by `python -m tests.benches.soak`.
"""

import logging
import re
from pathlib import Path

import pytest

from talc.frame import EventKind
from tests.benches.soak import SoakPlan, soaked, table
from tests.benches.soak_judged import Alarm, SoakFault, false_alarms, reported

WORDS = {
    "NC": re.compile(r"\b(NC|probing)\b"),
    "rtu1": re.compile(r"\b(rtu1|rtd1|bed)\b"),
    "can1": re.compile(r"\b(can1|fluids)\b"),
}
SILENT = SoakFault("a module on RTU is silent", 1000.0, 2000.0)


def problem(at_s: float, text: str = "bus rtu1, device rtd1: no answer") -> Alarm:
    return Alarm(at_s, EventKind.PROBLEM, text)


def ended(at_s: float, text: str = "device rtd1: answers again") -> Alarm:
    return Alarm(at_s, EventKind.PROBLEM_ENDED, text)


@pytest.mark.slow
@pytest.mark.simulated_time
async def test_hours_of_faults_and_restarts(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)  # pytest keeps every record
    found = await soaked(tmp_path, SoakPlan(days=0.1, seed=3, pause_s=1200.0, run_s=2400.0))
    assert found.good, table(found)


@pytest.mark.parametrize(
    ("alarms", "begins_s", "false_at_s"),
    [
        ([problem(1050.0), ended(2300.0)], [0.0], []),
        ([problem(990.0)], [0.0], [990.0]),
        ([problem(1050.0, "bus can1, device fluids: no answer")], [0.0], [1050.0]),
        ([problem(1050.0), problem(2100.0, "channel bed: sensor_fault"), ended(2300.0)], [0.0], []),
        ([problem(1050.0), ended(2300.0), problem(2301.0)], [0.0], [2301.0]),
        ([problem(1050.0), problem(1600.0)], [0.0, 1500.0], []),
        ([problem(1050.0), problem(2600.0)], [0.0, 2500.0], [2600.0]),
        ([Alarm(1500.0, EventKind.SENSOR_SUSPECT, "bed has shifted"), ended(2300.0)], [0.0], []),
    ],
    ids=[
        "while it lasts", "before it", "of another wire", "until the gateway says that it is over",
        "after it has said so", "in the next run, while it lasts", "in the next run, after it", "of a channel",
    ],
)  # fmt: skip
def test_a_fault_explains_alarms_of_its_wire(
    alarms: list[Alarm], begins_s: list[float], false_at_s: list[float]
) -> None:
    assert [alarm.at_s for alarm in false_alarms(alarms, [SILENT], begins_s, WORDS)] == false_at_s


@pytest.mark.parametrize(
    ("alarms", "expected"),
    [
        ([problem(1050.0)], True),
        ([problem(900.0)], True),  # from a fault before, and not over yet
        ([problem(900.0), ended(950.0)], False),
        ([problem(2050.0)], False),
        ([problem(1050.0, "bus can1: no answer")], False),
        ([], False),
    ],
)
def test_a_fault_is_reported_by_an_alarm_of_its_wire(alarms: list[Alarm], expected: bool) -> None:
    assert reported(SILENT, alarms, WORDS) is expected
