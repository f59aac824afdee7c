"""Planned loads in the gateway: what it learns from, when, and what a restart and a gap leave of it."""

import asyncio

import numpy as np
import pytest

from gateway.control.planned_loads import PlannedLoads
from talc.frame import Frame, Frames
from talc.planned import LoadResponse
from tests.benches.hot_bearing import BODIES, DAY, NAMES, Array, bodies, work
from tests.benches.stepped_clock import SteppedClock
from tests.benches.waits import until

BEARING, SPEED = NAMES.index("bearing"), NAMES.index("spindle_speed")
PLANNED = {"rest": {"spindle_speed": 0.0}, "roughing": {"spindle_speed": 7000.0}, "too fast": {"spindle_speed": 2e4}}


def is_load(name: str) -> bool:
    return name not in BODIES


def day(days: int) -> Array:
    return bodies(work(4, days), 4)


def fed(x: Array, k0: int = 0) -> PlannedLoads:
    found = PlannedLoads(NAMES, 300.0, PLANNED, is_load, SteppedClock())
    for k, row in enumerate(x, k0):
        found.follow(Frame(k, row, np.ones(len(NAMES), np.bool_)))
    return found


async def test_a_planned_load_is_foreseen_once_two_days_are_known() -> None:
    x = day(6)
    loads = fed(x)
    assert loads.changes(96) == dict.fromkeys(PLANNED), "nothing is learnt yet"
    await loads.learn()
    found = loads.changes(96)
    assert found["too fast"] is None
    rest, roughing = found["rest"], found["roughing"]
    assert rest is not None
    assert roughing is not None
    assert roughing.shape == (96, len(NAMES))
    alike = [np.append(work(4, 6), np.full(96, planned)) for planned in (0.0, 7000.0)]
    truth = np.diff([bodies(speed, 4)[-1, BEARING] for speed in alike])[0]
    assert roughing[-1, BEARING] - rest[-1, BEARING] == pytest.approx(truth, rel=0.2)
    assert roughing[-1, SPEED] - rest[-1, SPEED] == 7000.0


async def test_it_learns_by_itself_after_two_days_and_then_each_day() -> None:
    x, clock = day(3), SteppedClock()
    loads = PlannedLoads(NAMES, 300.0, PLANNED, is_load, clock)
    running = asyncio.create_task(loads.run())
    foreseen = list[int]()
    for k, row in enumerate(x):
        before = clock.holds
        loads.follow(Frame(k, row, np.ones(len(NAMES), np.bool_)))
        if k + 1 in (2 * DAY, 3 * DAY):
            await until(lambda: loads.changes(1)["rest"] is not None and not clock.holds)
            foreseen.append(k)
        else:
            await asyncio.sleep(0)
            assert clock.holds == before
    running.cancel()
    assert foreseen == [2 * DAY - 1, 3 * DAY - 1]


async def test_what_cannot_be_learnt_is_said_once_until_it_is_learnt_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fails(*_: object) -> LoadResponse:
        raise ValueError("no solution")

    loads = fed(day(3))
    with monkeypatch.context() as broken:
        broken.setattr("gateway.control.planned_loads.learn_response", fails)
        await loads.learn()
        await loads.learn()
    await loads.learn()
    said = [record.getMessage() for record in caplog.records]
    assert said == [
        "planned loads: how the inputs follow the loads could not be learnt",
        "planned loads: how the inputs follow the loads is learnt again",
    ]
    assert caplog.text.count("ValueError: no solution") == 1


async def test_a_restart_goes_on_from_the_stored_frames() -> None:
    x = day(6)
    frames = Frames(np.arange(len(x)), x, np.ones(x.shape, np.bool_), np.empty((0, 9)))
    again, one = PlannedLoads(NAMES, 300.0, PLANNED, is_load, SteppedClock(), frames), fed(x)
    await again.learn()
    await one.learn()
    mine, other = again.changes(96)["roughing"], one.changes(96)["roughing"]
    assert mine is not None
    assert other is not None
    np.testing.assert_array_equal(mine, other)


async def test_a_gap_is_unknown_and_not_rest() -> None:
    x = day(6)
    loads = fed(x[: 5 * DAY])
    for k, row in enumerate(x[5 * DAY + 24 :], 5 * DAY + 24):
        loads.follow(Frame(k, row, np.ones(len(NAMES), np.bool_)))
    await loads.learn()
    found, whole = loads.changes(96)["roughing"], fed(x)
    await whole.learn()
    expected = whole.changes(96)["roughing"]
    assert found is not None
    assert expected is not None
    np.testing.assert_allclose(found[:, BEARING], expected[:, BEARING], atol=0.5)


async def test_without_planned_loads_it_keeps_nothing() -> None:
    loads = PlannedLoads(NAMES, 300.0, {}, is_load, SteppedClock())
    loads.follow(Frame(0, day(1)[0], np.ones(len(NAMES), np.bool_)))
    assert loads.changes(96) == {}


async def test_a_spindle_that_runs_for_minutes_is_foreseen_without_a_plan() -> None:
    loads = PlannedLoads(NAMES, 300.0, {}, is_load, SteppedClock())
    x = day(6)
    for k, row in enumerate(x):
        loads.follow(Frame(k, row, np.ones(len(NAMES), np.bool_)))
    assert loads.during({"spindle_speed": 6000.0}, 4, 24) is None, "nothing is learnt yet"
    await loads.learn()
    usual = loads.of("")
    assert list(usual) == ["spindle_speed"]
    assert usual["spindle_speed"] == np.median(x[x[:, SPEED] > 0.0, SPEED])
    found = loads.during(usual, 4, 24)
    assert found is not None
    assert not found[4:, SPEED].any()
    with pytest.raises(ValueError, match="load = 'roughing'"):
        loads.of("roughing")
