"""The sensor watch and the planned loads at other grid steps than the default: a day and an hour are what they last."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from gateway.control.planned_loads import PlannedLoads, rows_remembered
from gateway.control.sensor_watch import SeenBefore, SensorWatch
from gateway.model.events import GatewayEvent, SensorsJudged
from talc.frame import Frame, Frames
from talc.settings import SensorCheckSettings
from tests.benches.hot_bearing import BODIES, DAY, NAMES, bodies, work
from tests.benches.sensor_teacher import SensorTeacher, nothing_learnt
from tests.benches.stepped_clock import SteppedClock
from tests.benches.wire_clock import WireClock

KNOWN = np.ones(len(NAMES), np.bool_)


class CountingClock(WireClock):
    """Counts how often it stood still for what follows the frames."""

    looks = 0

    @contextmanager
    def hold(self) -> Iterator[None]:
        self.looks += 1
        with super().hold():
            yield

    async def looked(self) -> int:
        """How often, once they are done."""
        await self.rest()
        return self.looks


def is_temperature(name: str) -> bool:
    return name in BODIES


async def test_sensors_are_learnt_each_day_and_judged_each_hour_at_ten_minutes() -> None:
    x, teacher, judged = bodies(work(3, 3), 3)[::2], SensorTeacher(), list[int]()

    def hear(event: GatewayEvent) -> None:
        if isinstance(event, SensorsJudged):
            judged.append(event.k)

    settings, clock = SensorCheckSettings(window_steps=48, learn_steps=4320), CountingClock()
    watching = SensorWatch(NAMES, settings, 600.0, is_temperature, hear, clock, None, teacher)
    running = asyncio.create_task(watching.run())
    first_k = 6000
    for k, row in enumerate(x, first_k):
        watching.follow(Frame(k, row, KNOWN))
        assert await clock.looked() == (k - first_k) // 6 + 1, "each hour"
    running.cancel()
    assert teacher.rows == [145, 145 + 144 - 48], "after a day, from all that was judged"
    assert set(teacher.steps_s) == {600.0}
    assert judged == list(range(first_k + 150, first_k + len(x), 6))


@pytest.mark.parametrize(("step_s", "a_day"), [(60.0, 1440), (300.0, 288)])
async def test_a_day_is_waited_for_where_fewer_rows_are_learnt_from(step_s: float, a_day: int) -> None:
    teacher = SensorTeacher(nothing_learnt)
    settings = SensorCheckSettings(window_steps=12, learn_steps=36)
    watching = SensorWatch(NAMES, settings, step_s, is_temperature, lambda _: None, SteppedClock(), None, teacher)
    for k in range(a_day):
        await watching.look()
        assert teacher.rows == []
        watching.follow(Frame(k, np.full(len(NAMES), 20.0), KNOWN))
    await watching.look()
    assert (teacher.rows, teacher.steps_s) == ([36], [step_s])


async def test_after_a_restart_a_long_record_of_which_a_part_is_kept_needs_no_other_day() -> None:
    teacher, settings = SensorTeacher(nothing_learnt), SensorCheckSettings(window_steps=12, learn_steps=36)
    for rows in (47, 48):
        k = np.arange(1000, 1000 + rows)
        inputs, valid = np.full((rows, len(NAMES)), 20.0), np.ones((rows, len(NAMES)), np.bool_)
        seen = Frames(k, inputs, valid, np.full((rows, 9), np.nan))
        watching = SensorWatch(
            NAMES, settings, 5.0, is_temperature, lambda _: None, SteppedClock(), SeenBefore(seen, None), teacher
        )
        await watching.look()
        assert teacher.rows == ([] if rows < 48 else [36]), "48 rows are all that is loaded"
    assert teacher.steps_s == [5.0]


async def test_no_row_goes_unjudged_where_a_window_is_shorter_than_an_hour() -> None:
    clock = CountingClock()
    settings = SensorCheckSettings(window_steps=96, learn_steps=288)
    watching = SensorWatch(NAMES, settings, 10.0, is_temperature, lambda _: None, clock, None, SensorTeacher())
    running = asyncio.create_task(watching.run())
    for k in range(400):
        watching.follow(Frame(k, np.full(len(NAMES), 20.0), KNOWN))
        assert await clock.looked() == k // 96 + 1
    running.cancel()


async def test_planned_loads_are_learnt_after_two_days_and_then_each_day_at_ten_minutes() -> None:
    x, clock = bodies(work(4, 3), 4)[::2], CountingClock()
    loads = PlannedLoads(NAMES, 600.0, {"rest": {"spindle_speed": 0.0}}, lambda name: name not in BODIES, clock)
    running = asyncio.create_task(loads.run())
    learnt = list[int]()
    for k, row in enumerate(x):
        loads.follow(Frame(k, row, KNOWN))
        if await clock.looked() > len(learnt):
            learnt.append(k + 1)
            assert loads.changes(1)["rest"] is not None
    running.cancel()
    assert learnt == [DAY, DAY + DAY // 2]


@pytest.mark.parametrize(("step_s", "rows"), [(300.0, 4032), (600.0, 2016), (30.0, 40_320), (1.0, 40_320)])
def test_planned_loads_are_learnt_from_two_weeks_that_fit_into_memory(step_s: float, rows: int) -> None:
    assert rows_remembered(step_s) == rows
