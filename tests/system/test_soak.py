"""Hours of random faults and restarts; what takes no simulated time; and what the soak does not excuse.

`python -m tests.benches.soak` runs for longer.
"""

import asyncio
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gateway.control.sensor_watch import SensorWatch
from gateway.model.events import EventReported, GatewayEvent, SensorsJudged
from talc.frame import EventKind, Frame
from talc.settings import SensorCheckSettings
from tests.benches.plant_days import NAMES, plant_days
from tests.benches.simulated_time import held_time, simulated_time
from tests.benches.small_run import START
from tests.benches.soak import RightClock, fast_forward
from tests.benches.soak_judged import SURPRISE, Alarm, SoakFault, asked_again, false_alarms, reported

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
def test_hours_of_faults_and_restarts() -> None:
    """In a separate process, so that what other tests keep open is not counted."""
    told = ["--days", "0.25", "--seed", "3", "--pause", "1800", "--run", "5400"]
    command = [sys.executable, "-m", "tests.benches.soak", *told, "--begin", str(int(START))]
    ran = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    print(ran.stdout)


def test_held_time_does_not_pass_while_another_process_works() -> None:
    async def waited_s() -> float:
        begin_s, passed = time.monotonic(), asyncio.Event()
        later = asyncio.get_running_loop().call_later(7200.0, passed.set)
        with held_time():
            process = await asyncio.create_subprocess_exec(sys.executable, "-c", "sum(range(10_000_000))")
            assert await process.wait() == 0
        waited = time.monotonic() - begin_s
        assert not passed.is_set()
        later.cancel()
        return waited

    with simulated_time():
        assert asyncio.run(waited_s()) < 1.0


@pytest.mark.slow
def test_a_soak_waits_for_the_process_that_learns_the_sensors() -> None:
    """Else a simulated hour passes in a second, and the gateway says that the process did not end within it."""
    events: list[GatewayEvent] = []
    x = plant_days(1)
    names = tuple(NAMES)

    async def learnt() -> float:
        watch = SensorWatch(names, SensorCheckSettings(), 300.0, lambda _: True, events.append, RightClock())
        for k, row in enumerate(x):
            watch.follow(Frame(k, row, np.ones(len(names), dtype=np.bool_)))
        begin_s = time.monotonic()
        later = asyncio.get_running_loop().call_later(4000.0, lambda: None)
        await watch.look()
        await watch.look()
        later.cancel()
        return time.monotonic() - begin_s

    with fast_forward():
        took_s = asyncio.run(learnt())
    assert took_s < 1.0
    assert [type(event) for event in events] == [SensorsJudged], [
        event.event.text for event in events if isinstance(event, EventReported)
    ]


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


def test_the_control_explains_alarms_until_the_gateway_is_connected_again() -> None:
    """Meanwhile a measurement may no longer be wanted, and then be wanted again."""
    off = SoakFault("the control is off", 1000.0, 2000.0)
    blocked = "probing: the control cannot be reached"
    alarms = [
        problem(1010.0, "NC: not connected"),
        problem(1100.0, blocked),
        ended(2030.0, f"probing, resolved: {blocked}"),
        problem(2100.0, blocked),
        ended(2400.0, "NC: connected again"),
        problem(2500.0, blocked),
    ]
    assert [alarm.at_s for alarm in false_alarms(alarms, [off], [0.0], WORDS)] == [2500.0]


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


@pytest.mark.parametrize(
    ("text", "probed", "begins_s", "again"),
    [
        (f"EZ0T: {SURPRISE}", [(900.0, True), (1000.0, False), (1300.0, True)], [0.0], True),
        (f"EZ0T: {SURPRISE}", [(900.0, True), (1000.0, False), (1300.0, False)], [0.0], False),
        (f"EZ0T: {SURPRISE}", [(1000.0, False), (1300.0, False)], [0.0, 1200.0], True),
        (f"EZ0T: {SURPRISE}", [(900.0, True), (1000.0, False)], [0.0], True),
        ("the centres differ by 12.1 µm RMS", [(1000.0, False), (1300.0, True)], [0.0], False),
    ],
    ids=[
        "the next was used", "the next was rejected as well", "the next was after a restart",
        "the soak ended before", "no surprise",
    ],
)  # fmt: skip
def test_a_surprise_that_the_next_cycle_explains_is_no_false_alarm(
    text: str, probed: list[tuple[float, bool]], begins_s: list[float], again: bool
) -> None:
    alarm = Alarm(1000.0, EventKind.MEASUREMENT_REJECTED, text)
    assert asked_again([alarm], probed, begins_s) == [alarm] * again
