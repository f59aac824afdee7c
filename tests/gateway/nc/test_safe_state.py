"""The safe-state contract of docs/safety.md on the wire to an emulated control, judged by the control's own record."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from gateway.acquisition.reload import ReloadError, bus_changes
from gateway.config.sections import Compensation, Probing
from gateway.model.compensation import Source
from simulators.nc.watchdog import R_OWNER, Logged
from talc.frame import Decision
from tests.benches.nc_link_bench import config as nc_config
from tests.benches.nc_link_bench import decision
from tests.benches.wire_bench import BOUND_UM, STALE_S, assert_never_stepped, config, wire_bench

pytestmark = pytest.mark.simulated_time

T = TypeVar("T")


def lacking(found: Decision, *names: str) -> Decision:
    return replace(found, substituted=names)


# Modes ---------------------------------------------------------------------------------------------------------------


def test_nothing_is_armed_unless_the_configuration_says_so() -> None:
    assert Compensation().mode == "monitor"
    assert Probing().armed is False


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_without_compensate_the_control_is_not_touched(mode: str, tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        before = list(bench.control.nck.r)
        async with bench.running(bench.link(mode), stop=True) as link:
            link.follow(decision(10.0))
            await bench.clock.run_until(30.0)
        assert bench.control.nck.r == before  # no claim, no beat
        assert bench.control.nck.log == []
        assert bench.writes[-1].step.offsets_um == (0.0, 0.0, 10.0)  # computed and stored all the same
        assert not any(write.written for write in bench.writes)


@pytest.mark.parametrize(("old", "new"), list(permutations(("monitor", "advise", "compensate"), 2)))
def test_the_mode_does_not_change_while_the_gateway_runs(old: str, new: str) -> None:
    with pytest.raises(ReloadError, match=r"\[compensation\] changed: restart"):
        bus_changes(config(old), config(new))


@pytest.mark.parametrize("now", [False, True])
def test_probing_is_neither_armed_nor_disarmed_by_a_reload(now: bool) -> None:
    with pytest.raises(ReloadError, match=r"\[probing\] changed: restart"):
        bus_changes(nc_config("monitor", armed=now), nc_config("monitor", armed=not now))


# Bound and slew ------------------------------------------------------------------------------------------------------


def test_the_default_slew_is_a_micrometre_per_second() -> None:
    assert Compensation().slew_um_per_s == 1.0


async def test_every_axis_has_its_own_bound_and_nothing_ever_steps(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        errors = np.zeros(9)
        errors[[0, 1, 2]] = 500.0  # EY0A, EZ0A, EX0C: all three axes far beyond
        link.follow(replace(decision(0.0), corrected=errors))
        await bench.clock.run_until(20.0)
        assert bench.in_force_um == pytest.approx(BOUND_UM)
        link.follow(replace(decision(0.0), corrected=-errors))
        await bench.clock.run_until(56.0)
        assert bench.in_force_um == pytest.approx(tuple(-b for b in BOUND_UM))
        bench.assert_never_stepped()
        assert bench.writes[-1].step.bounded == (True, True, True)


async def test_a_model_update_that_moves_the_prediction_is_ramped(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        for until, ez0a in ((10.0, 8.0), (30.0, -8.0), (45.0, 4.0)):
            link.follow(decision(ez0a))
            await bench.clock.run_until(until)
        bench.assert_never_stepped()
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 4.0))


# Without a basis for offsets ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("when_stale", "left"), [("zero", 0.0), ("hold", 6.0)])
@pytest.mark.parametrize("lost", ["decisions", "inputs", "model"])
async def test_without_a_prediction_to_rest_on_it_goes_where_declared(
    lost: str, when_stale: str, left: float, tmp_path: Path
) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link(when_stale=when_stale)) as link:
        link.follow(decision(6.0))
        await bench.clock.run_until(8.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
        match lost:
            case "decisions":
                await bench.clock.run_until(STALE_S - 1.0)
                assert bench.writes[-1].step.source is Source.PREDICTION
                await bench.clock.run_until(STALE_S + 10.0)
                expected = Source.STALE
            case "inputs":
                for step in range(3):
                    link.follow(lacking(decision(6.0), "spindle_front"))
                    await bench.clock.run_until(8.0 + 12.0 * (step + 1))
                    late = step == 2
                    assert (bench.writes[-1].step.source is Source.INPUTS_STALE) is late
                await bench.clock.run_until(54.0)
                expected = Source.INPUTS_STALE
            case _:
                link.follow(replace(decision(6.0), corrected=np.full(9, np.nan)))
                await bench.clock.run_until(20.0)
                expected = Source.NO_MODEL
        assert bench.writes[-1].step.source is expected
        assert bench.in_force_um == pytest.approx((0.0, 0.0, left))
        bench.assert_never_stepped()


@pytest.mark.parametrize(("when_stale", "left"), [("zero", 0.0), ("hold", 6.0)])
async def test_before_the_first_decision_it_goes_where_declared(when_stale: str, left: float, tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        bench.control.nck.write_k0(2, -0.006, 0.0)  # as an earlier run left it
        async with bench.running(bench.link(when_stale=when_stale)):
            await bench.clock.run_until(12.0)
        assert bench.writes[-1].step.source is Source.NO_MODEL
        assert bench.in_force_um == pytest.approx((0.0, 0.0, left))
        heights = [1e3 * entry.values_mm[2] for entry in bench.control.nck.log]
        assert np.abs(np.diff(heights)).max(initial=0.0) <= 1.0 + 1e-6


@pytest.mark.slow
async def test_an_input_that_comes_back_in_time_changes_nothing(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        for step in range(4):  # missing every other step, 20 s at the longest
            link.follow(lacking(decision(6.0), *(["spindle_front"] if step % 2 else [])))
            await bench.clock.run_until(20.0 * (step + 1))
        assert {write.step.source for write in bench.writes} == {Source.PREDICTION}


# Start, stop, kill, reconnect ----------------------------------------------------------------------------------------


async def test_killed_it_leaves_the_control_to_its_watchdog_and_started_again_it_goes_on_from_there(
    tmp_path: Path,
) -> None:
    async with wire_bench(tmp_path) as bench:
        async with bench.running(bench.link()) as link:
            link.follow(decision(10.0))
            await bench.clock.run_until(12.0)
        await bench.clock.run_until(19.0)  # silent since 12 s, then 1 µm/s
        left = bench.in_force_um[2]
        assert 5.0 < left < 9.0
        async with bench.running(bench.link()) as link:
            link.follow(decision(10.0))
            await bench.clock.run_until(40.0)
            assert bench.in_force_um == pytest.approx((0.0, 0.0, 10.0))
        bench.assert_never_stepped()
        after = [1e3 * abs(entry.values_mm[2]) for entry in bench.control.nck.log if entry.time_s > 19.0]
        assert min(after) > left - 2.0  # it did not begin at zero


@pytest.mark.parametrize(("when_stale", "left"), [("zero", 0.0), ("hold", 10.0)])
async def test_stopped_or_killed_the_end_is_the_declared_one(when_stale: str, left: float, tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        for stop in (True, False):
            async with bench.running(bench.link(when_stale=when_stale), stop=stop) as link:
                link.follow(decision(10.0))
                await bench.clock.run_until(bench.clock.monotonic() + 14.0)
            await bench.clock.run_until(bench.clock.monotonic() + 20.0)
            assert bench.in_force_um == pytest.approx((0.0, 0.0, left))
        bench.assert_never_stepped()


def cancelled_with(task: asyncio.Task[None] | None, left: list[int], request: Callable[[], T]) -> Callable[[], T]:
    """The control's own answer to a request; cancels the task during it once no earlier request is left to count.

    None: it only counts down.
    """

    def answered() -> T:
        if left[0] == 0 and task is not None:
            task.cancel()
        left[0] -= 1
        return request()

    return answered


@pytest.mark.slow
async def test_stopped_within_any_request_it_takes_the_offsets_back_and_releases_the_control(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        control = bench.control
        state, wake, counted = control.state, control.wake, [0]
        async with bench.running(bench.link(), stop=True):
            await bench.clock.run_until(4.5)
            control.state = cancelled_with(None, counted, state)  # type: ignore[method-assign]
            control.wake = cancelled_with(None, counted, wake)  # type: ignore[method-assign]
            await bench.clock.run_until(5.5)
            requests_of_a_cycle = -counted[0]
            control.state, control.wake = state, wake  # type: ignore[method-assign]
        assert requests_of_a_cycle >= 5, "heartbeat, look, write and read-back"
        for number in range(requests_of_a_cycle):
            left = [number]
            link = bench.link()
            running = asyncio.create_task(link.run())
            link.follow(decision(10.0))
            await bench.clock.run_until(bench.clock.monotonic() + 4.5)

            control.state = cancelled_with(running, left, state)  # type: ignore[method-assign]
            control.wake = cancelled_with(running, left, wake)  # type: ignore[method-assign]
            await bench.clock.run_until(bench.clock.monotonic() + 1.0)
            assert running.cancelled()
            control.state, control.wake = state, wake  # type: ignore[method-assign]
            stopping = asyncio.create_task(link.stop())
            await bench.clock.run_until(bench.clock.monotonic() + 30.0)
            await stopping
            assert bench.writes[-1].step.source is Source.STOPPED
            assert bench.in_force_um == pytest.approx((0.0, 0.0, 0.0))
            assert control.nck.r[R_OWNER] == 0.0
        assert bench.notices == []
        bench.assert_never_stepped()


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_restarted_in_another_mode_the_offsets_end_at_zero_without_a_step(mode: str, tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        for now, wanted in (("compensate", 8.0), (mode, 0.0), ("compensate", 8.0)):
            async with bench.running(bench.link(now)) as link:
                link.follow(decision(8.0))
                await bench.clock.run_until(bench.clock.monotonic() + 14.0)
                assert bench.in_force_um == pytest.approx((0.0, 0.0, wanted))
        bench.assert_never_stepped()


async def test_after_the_connection_was_cut_it_goes_on_without_a_step(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        link.follow(decision(8.0))
        await bench.clock.run_until(10.0)
        await link.disconnect()
        link.follow(decision(-4.0))
        await bench.clock.run_until(35.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, -4.0))
        bench.assert_never_stepped()


# The control's own events --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alarms_before", [0, 4, 15, 20])
async def test_in_an_emergency_stop_the_offsets_stand_and_nothing_is_saved_up(
    alarms_before: int, tmp_path: Path
) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        link.follow(decision(4.0))
        await bench.clock.run_until(6.0)
        for number in range(alarms_before):
            bench.control.nck.raise_alarm(21600 + number, bench.clock.monotonic())
        bench.control.nck.emergency_stop(bench.clock.monotonic())
        link.follow(decision(12.0))
        await bench.clock.run_until(30.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 4.0))
        assert bench.writes[-1].step.source is Source.NOT_READY
        bench.control.nck.clear_alarms(bench.clock.monotonic())
        await bench.clock.run_until(33.0)
        assert bench.in_force_um[2] <= 4.0 + 4.0  # no stride for the time that stood still
        await bench.clock.run_until(42.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 12.0))
        bench.assert_never_stepped()


async def test_in_an_emergency_stop_while_it_stops_nothing_more_is_written(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        link = bench.link()
        running = asyncio.create_task(link.run())
        link.follow(decision(10.0))
        await bench.clock.run_until(12.0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        stopping = asyncio.create_task(link.stop())
        await bench.clock.run_until(15.5)
        assert 5.0 < bench.in_force_um[2] < 9.0
        bench.control.nck.emergency_stop(bench.clock.monotonic())
        before = [entry for entry in bench.control.nck.log if not entry.ramped]
        await bench.clock.run_until(60.0)
        await stopping
        assert [entry for entry in bench.control.nck.log if not entry.ramped] == before
        assert bench.writes[-1].step.source is Source.NOT_READY
        assert not bench.writes[-1].written
        assert bench.control.nck.r[R_OWNER] == 0.0
        bench.assert_never_stepped()


async def test_after_power_off_it_waits_for_homing_and_begins_at_zero(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        link.follow(decision(6.0))
        await bench.clock.run_until(8.0)
        bench.control.nck.power_on(bench.clock.monotonic())
        off = bench.clock.monotonic()
        await bench.clock.run_until(25.0)
        assert bench.in_force_um == (0.0, 0.0, 0.0)
        assert bench.control.nck.shift_um((0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
        bench.control.nck.reference(bench.clock.monotonic())
        link.follow(decision(6.0))
        await bench.clock.run_until(40.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
        bench.assert_never_stepped(but_at_s=off)


# Read back, record, second gateway -----------------------------------------------------------------------------------


async def test_offsets_that_somebody_else_set_are_not_written_over(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        link.follow(decision(6.0))
        await bench.clock.run_until(8.0)
        bench.control.nck.write_k0(0, 0.0121, bench.clock.monotonic())  # by hand, at the operator's panel
        count = len(bench.control.nck.log)
        await bench.clock.run_until(11.0)
        assert len(bench.control.nck.log) == count
        assert not link.armed
        assert len([n for n in bench.notices if "disarmed until a restart" in n]) == 1
        await bench.clock.run_until(35.0)  # and no beat either: the watchdog brings all of it to zero
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 0.0))


async def test_a_write_that_does_not_show_disarms_and_the_watchdog_takes_over(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench, bench.running(bench.link()) as link:
        link.follow(decision(6.0))
        await bench.clock.run_until(8.0)
        bench.control.nck.slope[2] = 1e-3  # a slope of somebody's: what is in force is no longer what was written
        bench.control.nck.reference_mm[2] = -50.0
        await bench.clock.run_until(12.0)
        assert not link.armed
        assert any("are in force; compensation is disarmed" in n for n in bench.notices)
        await bench.clock.run_until(30.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "log",
    [
        [Logged(10.0, (0.0, 0.0, 0.0025), ramped=False)],
        [Logged(10.0, (0.001, 0.0, 0.0), ramped=False), Logged(10.5, (0.002, 0.0, 0.0), ramped=False)],
        [Logged(10.0, (0.0, 0.011, 0.0), ramped=True)],
        [Logged(float(t), (1e-3 * t, 0.0, 0.0), ramped=False) for t in range(1, 14)],  # beyond the bound
    ],
)
def test_the_record_s_own_check_can_fail(log: list[Logged]) -> None:
    with pytest.raises(AssertionError):
        assert_never_stepped(log, BOUND_UM, 1.0, 1.0)
