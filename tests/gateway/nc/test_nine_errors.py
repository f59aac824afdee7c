"""The nine errors go to a control that works out the offsets itself.

The tests cover their form, their slew, and the link that sends them.
"""

import asyncio
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.nc import NineErrors, ProbingState, RequestStatus, TakesSlopes
from gateway.model.compensation import Write
from gateway.model.notice import Notice
from gateway.model.probing import End
from gateway.nc.link import NcLink
from gateway.nc.routes import AgentRoute, ByErrors, differ, positions
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.nc.slew import Slew
from talc import kinematics
from talc.frame import Why
from tests.benches.nc_link_bench import ScriptedControl, config, decision
from tests.benches.stepped_clock import SteppedClock
from tests.benches.waits import turns

REACH_MM, RADIUS_M, BOUND_UM = (300.0, 400.0), 0.12, (50.0, 50.0, 60.0)
WARM = np.array([3.0, -48.8, 10.0, 4.0, 20.0, 12.6, 30.0, -25.0, 15.0])
NOTHING = NineErrors((0.0,) * 9, 120.0, (0.0, 0.0, 0.0))
AT = np.array([150.0, -80.0, 120.0, 0.5, 1.0])


@dataclass
class Following(ScriptedControl):
    """Works out the offsets itself once it has greeted with its reach; its slew is fast."""

    error_reach_mm: tuple[float, float] | None = REACH_MM
    slopes: TakesSlopes | None = None
    errors: NineErrors = NOTHING

    async def write_errors(self, errors: NineErrors) -> None:
        self.errors = errors

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        assert radius_mm == self.errors.radius_mm
        return self.errors.errors


def form(control: Following) -> ByErrors:
    return ByErrors(control, REACH_MM, RADIUS_M, BOUND_UM)


async def test_the_errors_arrive_as_they_were_predicted_and_are_read_back_the_same() -> None:
    control = Following(SteppedClock())
    wanted = form(control).wanted(WARM, AT, RADIUS_M)
    await form(control).write(wanted)
    assert control.errors.errors == pytest.approx(tuple(WARM))
    assert (control.errors.radius_mm, control.errors.bound_um) == (120.0, BOUND_UM)
    found = await form(control).read()
    assert not differ(found, wanted)
    assert differ(found, form(control).wanted(WARM + np.eye(9)[6], AT, RADIUS_M)), "one µm/m of tilt"
    shift = (found * form(control).basis(AT)).sum(axis=1)
    assert shift == pytest.approx(kinematics.tcp_offsets(WARM, AT, RADIUS_M))


async def test_an_a_axis_that_has_turned_many_times_is_where_it_is() -> None:
    snapshot = await ScriptedControl(SteppedClock()).snapshot()
    tilted, turned = (replace(snapshot, positions=snapshot.positions | {"A": a}) for a in (-35.0, 3565.0))
    assert positions(turned) == pytest.approx(positions(tilted))
    assert kinematics.tcp_offsets(WARM, positions(turned), RADIUS_M) == pytest.approx(
        kinematics.tcp_offsets(WARM, positions(tilted), RADIUS_M)
    )


def test_no_point_of_the_travel_moves_faster_than_the_slew_and_the_nine_keep_their_proportion() -> None:
    of = form(Following(SteppedClock()))
    it = Slew(BOUND_UM, 1.0, "zero", 1.0, np.zeros((3, 9)), 0.0, together=True)
    wanted, rng = of.wanted(WARM, AT, RADIUS_M), np.random.default_rng(1)
    poses = rng.uniform((-300, -280, -280, -2, -6), (300, 280, 280, 2, 6), (200, 5))
    bases = np.array([of.basis(pose) for pose in poses])
    before = np.zeros((3, 9))
    for steps in turns():
        now = np.array(it.follow(float(steps), wanted, basis=of.basis(AT)).coefficients_um)
        assert np.abs(((now - before) * bases).sum(axis=2)).max() <= 1.0 + 1e-9
        share = now[wanted != 0] / wanted[wanted != 0]
        assert np.ptp(share) < 1e-9, "still nine errors, and not three rows"
        before = now
        if not differ(before, wanted):
            break
    assert steps == pytest.approx(np.abs(wanted).sum(axis=1).max(), abs=1.0)


def test_the_step_tells_what_the_control_bounds_where_the_tool_is() -> None:
    of = form(Following(SteppedClock()))
    high = np.array([0.0, 80.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    it = Slew(BOUND_UM, 1.0, "zero", 1000.0, np.zeros((3, 9)), 0.0, together=True)
    step = it.follow(1000.0, of.wanted(high, AT, RADIUS_M), basis=of.basis(AT))
    assert step.offsets_um == pytest.approx((0.0, 0.0, 60.0))
    assert step.bounded == (False, False, True)
    assert sum(step.coefficients_um[2]) == pytest.approx(80.0), "the error itself is what it is"


async def test_a_control_that_does_not_greet_with_its_reach_gets_shifts() -> None:
    control = Following(SteppedClock(), error_reach_mm=None)
    it = AgentRoute(control, RADIUS_M, BOUND_UM)
    assert not it.together
    await it.write(it.wanted(WARM, AT, RADIUS_M))
    assert control.writes[0][1] == pytest.approx(tuple(kinematics.tcp_offsets(WARM, AT, RADIUS_M)))
    control.error_reach_mm = REACH_MM  # its agent was replaced
    assert it.together


def link_of(
    control: Following, steps: list[Write], notices: list[Notice] | None = None, when_stale: str = "zero"
) -> NcLink:
    settings = LinkSettings.of(config("compensate", when_stale=when_stale), Identity())
    tell = list[Notice]().append if notices is None else notices.append
    return NcLink(
        control, control.clock, settings, Earlier(first_number=41), Listeners(written=steps.append, notify=tell)
    )


async def test_a_control_whose_program_is_missing_is_reported_until_it_is_there() -> None:
    clock, notices = SteppedClock(), list[Notice]()
    control = Following(clock, error_reach_mm=None)
    task = asyncio.create_task(link_of(control, [], notices).run())
    await clock.run_until(3.0)
    control.absent = True
    await clock.run_until(4.0)
    control.absent, control.error_reach_mm = False, REACH_MM
    await clock.run_until(40.0)
    told = [notice for notice in notices if notice.subject == "form of NC"]
    assert [notice.ended for notice in told] == [False, True]
    assert "one shift per period" in told[0].text
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_disarmed_link_does_not_say_that_the_program_is_there() -> None:
    clock, notices = SteppedClock(), list[Notice]()
    control = Following(clock, error_reach_mm=None)
    link = link_of(control, [], notices)
    task = asyncio.create_task(link.run())
    await clock.run_until(3.0)
    control.in_force = (0.0, 30.0, 0.0)
    link.follow(decision(5.0))
    await clock.run_until(6.0)
    assert not link.armed
    control.absent = True
    await clock.run_until(7.0)
    control.absent = False
    await clock.run_until(40.0)
    assert [notice.ended for notice in notices if notice.subject == "form of NC"] == [False]
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_the_link_sends_nine_errors_and_takes_them_back_when_it_stops() -> None:
    clock = SteppedClock()
    control, steps = Following(clock), list[Write]()
    link = link_of(control, steps)
    link.follow(decision(5.0))
    task = asyncio.create_task(link.run())
    before = 0.0
    for second in range(8):
        await clock.run_until(float(second))
        now = control.errors.errors[1]
        assert now - before <= 1.0 + 1e-9
        before = now
    assert control.errors.errors == pytest.approx((0.0, 5.0) + (0.0,) * 7)
    assert control.writes == [], "and no shift"
    assert steps[-1].read_back_um == pytest.approx((0.0, 0.0, 5.0))
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    stopping = asyncio.create_task(link.stop())
    await clock.run_until(30.0)
    await stopping
    assert control.errors.errors == pytest.approx((0.0,) * 9)


async def test_a_cycle_is_judged_with_the_shift_that_the_control_reports() -> None:
    clock = SteppedClock()
    control, steps = Following(clock), list[Write]()
    link = link_of(control, steps)
    task = asyncio.create_task(link.run())
    await clock.run_until(2.0)
    centres = tuple((0.0, 0.0, 0.1 * pose) for pose in range(6))
    control.answer = RequestStatus(41, ProbingState.DONE, centres, in_force_um=(1.0, 2.0, 3.0))
    asked = asyncio.create_task(link.measure(Why.CALIBRATION))
    await clock.run_until(40.0)
    outcome = await asked
    assert outcome.in_force_um == pytest.approx((1.0, 2.0, 3.0))
    assert outcome.end is End.MEASURED
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize(("heard", "end"), [(True, End.MEASURED), (False, End.REJECTED)])
async def test_a_cycle_in_which_the_control_did_not_hear_the_gateway_makes_no_measurement(
    heard: bool, end: End
) -> None:
    """It lets the shift follow the position then, also with `hold`, which changes none of the nine."""
    clock = SteppedClock()
    control = Following(clock)
    link = link_of(control, [], when_stale="hold")
    task = asyncio.create_task(link.run())
    link.follow(decision(5.0))
    await clock.run_until(20.0)
    asked = asyncio.create_task(link.measure(Why.CALIBRATION))
    await clock.run_until(25.0)
    control.watching = heard
    await clock.run_until(27.0)
    control.watching = True
    control.answer = RequestStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6, in_force_um=(0.0, 0.0, 5.0))
    await clock.run_until(60.0)
    assert (await asked).end is end
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
