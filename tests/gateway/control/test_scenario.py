"""A scenario is what becomes of the present step's estimates, and the next step's has nothing of it."""

from datetime import UTC, datetime

import numpy as np
import pytest

from gateway.control.planned_loads import PlannedLoads
from gateway.control.scenario import Scenarios
from gateway.telemetry.scenario_queries import ScenarioRequest, parse_scenario
from talc.control import Controller
from talc.frame import Frame, Measurement
from talc.settings import TalcSettings
from tests.benches.hot_bearing import BODIES, DAY, NAMES, bodies, work
from tests.benches.stepped_clock import SteppedClock

NOW = datetime(2026, 3, 2, 6, tzinfo=UTC)
ALL = np.ones(len(NAMES), np.bool_)
PLANNED = {"roughing": {"spindle_speed": 7000.0}}


async def test_it_is_of_the_present_step_and_of_a_load_that_is_planned() -> None:
    controller = Controller(NAMES, TalcSettings(method="learner"))
    loads = PlannedLoads(NAMES, 300.0, PLANNED, lambda name: name not in BODIES, SteppedClock())
    scenarios, asked = Scenarios(controller, loads, 300.0), ScenarioRequest("roughing", 20)
    with pytest.raises(OSError, match="forecast"):
        scenarios(asked, NOW)
    for k, row in enumerate(bodies(work(4, 3), 4)):
        frame = Frame(k, row, ALL, Measurement(np.full(9, 0.1 * row[0]), np.full(9, 0.3)) if k % 24 == 0 else None)
        controller.step(frame)
        loads.follow(frame)
    first = scenarios(asked, NOW)
    assert (first.k, first.minutes, first.loads) == (3 * DAY - 1, 20.0, PLANNED["roughing"])
    assert first.loaded == {}, "what the load does is not known yet"
    with pytest.raises(ValueError, match="rest"):
        scenarios(ScenarioRequest("rest", 20), NOW)

    await loads.learn()
    assert scenarios(ScenarioRequest("roughing", 21), NOW).loaded, "of the same step, but another question"
    controller.step(Frame(3 * DAY, row + 5.0, ALL))
    later = scenarios(asked, NOW)
    assert later.k == 3 * DAY
    assert later.stays["EY0A"] != first.stays["EY0A"]
    assert later.loaded["EY0A"] != later.stays["EY0A"]


@pytest.mark.parametrize("minutes", ["", "0", "121", "-5", "2.5", "1e1", "²", "٣", "0020", "20m"])
def test_minutes_that_are_none_are_refused(minutes: str) -> None:
    with pytest.raises(ValueError, match="minutes = "):
        parse_scenario(f"load=roughing;minutes={minutes}")


def test_a_load_runs_for_twenty_minutes_unless_it_is_said() -> None:
    assert parse_scenario("load=roughing") == ScenarioRequest("roughing", 20)
    assert parse_scenario("minutes=120") == ScenarioRequest("", 120)
