"""What goes wrong between the gateway's link and a control over its real protocol, and what the link makes of it.

Faults of the driver alone are in tests/drivers/test_sinumerik_faults.py, _security.py and _subscription.py.
"""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import ProbingState, Watch
from drivers.sinumerik import Sinumerik
from drivers.sinumerik_settings import SinumerikSettings
from gateway.compensation import Source, Write
from gateway.config.model import validate
from gateway.measurement import End, Probe, poses_in_radians
from gateway.nc_link import NcLink
from simulators.nc import Block, CycleSettings, EmulatedControl, Kind, LoadCase, Loads, User
from simulators.nc.cycle import Reason
from simulators.nc.nck import R_REQUEST, R_RESULTS, R_WITHDRAW, MachineState
from simulators.nc.variables import ALARMS_SHOWN, Right
from talc.frame import Decision, Phase, Why
from tests.drivers.cut_line import Line, line_to
from tests.drivers.emulated_bench import Rigid
from tests.gateway.wire_clock import WireClock

SLEW_UM_PER_S = 1.0
CYCLE = CycleSettings(noise_um=0.0)


class Control(EmulatedControl):
    """An emulated control that the tests can spoil."""

    frozen: MachineState | None = None
    """Shown instead of what the machine does."""
    clock_wrong_by = timedelta()
    looks = 0

    def state(self) -> MachineState:
        self.looks += 1
        now = super().state()
        return now if self.frozen is None else self.frozen

    def utc(self) -> datetime:
        return super().utc() + self.clock_wrong_by


@dataclass
class Bench:
    """A link at work, over a line that can be cut."""

    clock: WireClock
    control: Control
    link: NcLink
    line: Line
    notices: list[tuple[str, bool]] = field(default_factory=list)
    steps: list[Write] = field(default_factory=list)

    def told(self, ended: bool) -> list[str]:
        return [text for text, over in self.notices if over is ended]

    def shift(self) -> np.ndarray:
        return np.array(self.control.nck.shift_um((0.0, 0.0, 0.0)))

    def jumps_um(self) -> float:
        """Largest change of SD43900 between two changes of it."""
        values = np.array([(0.0, 0.0, 0.0), *(entry.values_mm for entry in self.control.nck.log)]) * 1e3
        return float(np.abs(np.diff(values, axis=0)).max())


def wants(z_um: float) -> Decision:
    errors = np.zeros(9)
    errors[1] = z_um  # EZ0A: at A = 0 the offset in Z
    return Decision(1, Phase.COMPENSATION, errors, errors, np.full(9, math.nan), np.full(9, math.nan), None, None, ())


@asynccontextmanager
async def bench(
    *, mode: str = "compensate", start: bool = True, users: dict[str, User] | None = None, password: Path | None = None,
    subscribe_s: float = 0.0, owner: int = 1,
) -> AsyncIterator[Bench]:  # fmt: skip
    clock = WireClock()
    loads = Loads(x=60.0, spindle=3000.0)
    control = Control(Rigid(), clock, LoadCase([Block(0.0, 1e9, Kind.ROUGHING, loads)]), cycle=CYCLE, users=users)
    async with AsyncExitStack() as stack:
        url = await control.start()
        stack.push_async_callback(asyncio.get_running_loop().shutdown_default_executor)
        stack.push_async_callback(control.stop)
        if not start:
            await control.stop()
        line, joined = await stack.enter_async_context(line_to(url))
        user = "" if password is None else "gateway"
        settings = SinumerikSettings(
            url=joined, timeout_s=1.0, user=user, password_file=password, subscribe_s=subscribe_s
        )
        config = validate(
            {
                "machine": {"name": "mill"},
                "nc": {"kind": "sinumerik", "url": joined, "security": "none"},
                "probing": {"armed": True, "timeout_s": 300.0, "reference_cycles": 1},
                "compensation": {"mode": mode, "slew_um_per_s": SLEW_UM_PER_S, "stale_after_s": 5000.0},
            }
        )
        nc = Sinumerik(settings, clock)
        found = Bench(clock, control, None, line)  # type: ignore[arg-type]  # made with its callbacks
        found.link = NcLink(
            nc, config, clock, Probe(poses_in_radians(CYCLE.poses_deg), 0.12, 0.08, 1.0),
            states=lambda *_: None, written=found.steps.append,
            notify=lambda text, over: found.notices.append((text, over)),
            reference_mm=None, first_number=41, owner=owner,
        )  # fmt: skip
        task = asyncio.create_task(found.link.run())
        try:
            yield found
        finally:
            died = task.done()
            task.cancel()
            [error] = await asyncio.gather(task, return_exceptions=True)
            await nc.close()
            assert not died, error


async def test_a_control_that_is_absent_at_the_start_is_told_once_and_compensated_when_it_comes() -> None:
    async with bench(start=False) as at:
        at.link.follow(wants(4.0))
        await at.clock.run_until(10.0)
        assert len(at.told(ended=False)) == 1
        assert at.link.present is None
        await at.control.start()
        await at.clock.run_until(60.0)
        assert at.told(ended=True) == ["NC: connected again"]
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 4.0], atol=1e-9)


async def test_a_line_lost_in_the_middle_of_a_write_leaves_no_step_behind() -> None:
    async with bench() as at:
        at.link.follow(wants(40.0))
        await at.clock.run_until(10.0)
        write = at.control.nck.write_k0
        written: list[int] = []

        def cut_after_the_first_axis(axis: int, value_mm: float, now_s: float) -> None:
            if not written:
                written.append(axis)
                at.line.abort()
            write(axis, value_mm, now_s)

        at.control.nck.write_k0 = cut_after_the_first_axis  # type: ignore[method-assign]
        await at.clock.run_until(100.0)
        assert written
        assert len(at.told(ended=False)) == len(at.told(ended=True)) == 1
        assert at.link.armed
        assert at.jumps_um() <= SLEW_UM_PER_S + 1e-6
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 40.0], atol=1e-9)


@pytest.mark.parametrize("while_it", ["ramps", "writes", "probes"])
async def test_a_server_that_restarts_leaves_no_step_behind_and_its_cycle_is_no_measurement(while_it: str) -> None:
    async with bench() as at:
        nck, write = at.control.nck, at.control.nck.write_k0
        at.link.follow(wants(40.0))
        await at.clock.run_until(10.0)
        stopping: list[asyncio.Task[None]] = []

        def stop_after_the_first_axis(axis: int, value_mm: float, now_s: float) -> None:
            if not stopping:
                stopping.append(asyncio.create_task(at.control.stop()))
            write(axis, value_mm, now_s)

        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL)) if while_it == "probes" else None
        if while_it == "writes":
            nck.write_k0 = stop_after_the_first_axis  # type: ignore[method-assign]
            await at.clock.run_until(12.0)
            await stopping[0]
        else:
            await at.clock.run_until(70.0 if while_it == "probes" else 10.0)
            assert (nck.cycle.started_s is not None) is (while_it == "probes")
            await at.control.stop()
        await at.clock.run_until(at.clock.monotonic() + 5.0)
        await at.control.start()
        await at.clock.run_until(400.0)
        assert len(at.told(ended=False)) == len(at.told(ended=True)) == 1
        assert at.link.armed
        assert at.jumps_um() <= SLEW_UM_PER_S + 1e-6
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 40.0], atol=1e-9)
        if cycle is not None:
            assert (await cycle).end is End.REFUSED
            assert nck.cycle.answer.reason is Reason.WITHDRAWN
            assert written_meanwhile(at.control) == []


async def test_a_line_lost_while_it_probes_is_no_measurement_and_the_next_cycle_has_another_number() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        at.control.nck.cycle.withdraw = lambda *_: None  # type: ignore[method-assign]  # the NC program does not look
        first = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(60.0)
        assert at.control.nck.cycle.started_s is not None
        await at.line.cut()
        at.line.silent = True
        await at.clock.run_until(70.0)
        at.line.silent = False
        lost = await first
        await at.clock.run_until(400.0)  # meanwhile the control has ended the cycle by itself
        assert at.control.nck.cycle.answer.centres_mm
        second = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(700.0)
        found = await second
    assert (lost.measurement, lost.end) == (None, End.REFUSED)
    assert "lost" in lost.reason or "answer" in lost.reason or "connect" in lost.reason
    assert found.measurement is not None
    assert found.number == lost.number + 1


def written_meanwhile(control: Control) -> list[float]:
    """When offsets changed while the control probed, by its own record."""
    return [e.time_s for e in control.nck.log for began, ended in control.nck.cycle.ended if began < e.time_s < ended]


@pytest.mark.parametrize("looks", [True, False])
@pytest.mark.parametrize("left_by", ["a line that is lost", "a gateway that is killed"])
async def test_a_cycle_that_nobody_waits_for_any_more_is_taken_back_and_the_offsets_stand_until_it_ends(
    left_by: str, looks: bool
) -> None:
    async with bench() as at:
        nck = at.control.nck
        if not looks:
            nck.cycle.withdraw = lambda *_: None  # type: ignore[method-assign]  # the NC program looks between poses
        at.link.follow(wants(5.0))
        await at.clock.run_until(12.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(60.0)
        assert nck.cycle.started_s is not None
        at.link.follow(wants(25.0))
        if left_by == "a line that is lost":
            await at.line.cut()
            at.line.silent = True
            await at.clock.run_until(66.0)
            at.line.silent = False
        else:
            cycle.cancel()  # the next run takes back what this one asked for
        await at.clock.run_until(300.0)
        await asyncio.gather(cycle, return_exceptions=True)
        assert nck.r[R_WITHDRAW] == 41.0
        assert len(nck.cycle.ended) == 1
        (began, ended), answer = nck.cycle.ended[0], nck.cycle.answer
        assert ended - began > 100.0 if not looks else answer.reason is Reason.WITHDRAWN
        assert written_meanwhile(at.control) == []
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 25.0], atol=1e-9)


@pytest.mark.parametrize("mode", ["monitor", "compensate"])
async def test_offsets_stand_still_also_while_somebody_else_has_the_control_probe(mode: str) -> None:
    async with bench(mode=mode) as at:
        nck = at.control.nck
        at.link.follow(wants(5.0))
        other = Sinumerik(SinumerikSettings(url=f"opc.tcp://127.0.0.1:{at.line.target}"), at.clock)
        await at.clock.run_until(12.0)
        await other.connect()
        await other.request_probing(900)
        ours = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(20.0)
        refused = ours.result()
        at.link.follow(wants(25.0))
        await at.clock.run_until(60.0)
        assert nck.cycle.started_s is not None
        again = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(65.0)
        assert again.result().end is refused.end is End.REFUSED
        await at.clock.run_until(300.0)
        assert (await other.probing_status(900)).state is ProbingState.DONE
        await other.close()
        assert "request 900 waits" in refused.reason
        assert "cycle 900 is under way" in (await again).reason
        assert written_meanwhile(at.control) == []
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 25.0 if mode == "compensate" else 0.0], atol=1e-9)


async def test_who_is_displaced_by_a_request_of_the_same_moment_does_not_wait_for_it() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(4.0)
        at.control.nck.write_r(R_REQUEST, 900.0, at.clock.monotonic())
        await at.clock.run_until(20.0)
        assert cycle.done()
        outcome = await cycle
    assert (outcome.measurement, outcome.end) == (None, End.REFUSED)
    assert "does another gateway probe?" in outcome.reason


async def test_a_gateway_that_hangs_while_the_control_probes_makes_no_measurement_of_it() -> None:
    async with bench() as at:
        at.link.follow(wants(20.0))
        await at.clock.run_until(40.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(90.0)
        assert at.control.nck.cycle.started_s is not None
        at.clock.spend(22.0)  # watchdog_s is 10: it takes 12 µm away
        await at.clock.run_until(113.0)
        assert at.shift()[2] == pytest.approx(8.0, abs=1.5)
        await at.clock.run_until(400.0)
        hung = await cycle
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 20.0], atol=1e-9)
    assert (hung.measurement, hung.end) == (None, End.REJECTED)
    assert "the offsets moved while the control probed" in hung.reason


async def test_a_slope_that_the_gateway_does_not_know_makes_no_measurement() -> None:
    async with bench(mode="monitor") as at:
        at.control.nck.slope[0] = 1e-3  # 1 µm per mm of X, and the poses differ in X
        await at.clock.run_until(2.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(400.0)
        found = await cycle
    assert (found.measurement, found.end) == (None, End.REJECTED)
    assert "the offsets moved while the control probed" in found.reason


async def test_a_result_that_comes_after_its_time_is_never_taken_for_the_next_one() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        at.control.nck.cycle.withdraw = lambda *_: None  # type: ignore[method-assign]  # the NC program does not look
        program = at.control.nck.cycle._next_safe_point
        at.control.nck.cycle._next_safe_point = lambda now_s: now_s + 250.0
        first = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(320.0)
        late = await first
        at.control.nck.cycle._next_safe_point = program
        second = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(380.0)  # now the first one is done
        refused = await second
        assert at.control.nck.cycle.answer.number == late.number
        assert at.control.nck.cycle.answer.centres_mm
        third = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(640.0)
        found = await third
    assert late.measurement is None
    assert "did not end within 300 s" in late.reason
    assert found.measurement is not None
    assert f"cycle {late.number} is under way" in refused.reason
    assert found.number == late.number + 2
    assert found.ended - found.asked > timedelta(seconds=100)


async def test_a_result_that_is_no_number_or_told_twice_is_one_answer_at_most() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        show = at.control.nck._show_answer

        def spoiled() -> None:
            show()
            at.control.nck.r[R_RESULTS + 4] = math.nan

        at.control.nck._show_answer = spoiled  # type: ignore[method-assign]
        first = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(200.0)
        nan = await first
        at.control.nck._show_answer = show  # type: ignore[method-assign]
        second = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(400.0)
        good = await second
        # The control goes on showing it as done; a third request waits for its own.
        third = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(410.0)
        assert not third.done()
        await at.clock.run_until(600.0)
        again = await third
    assert (nan.measurement, nan.end) == (None, End.REJECTED)
    assert "not a finite number" in nan.reason
    assert good.measurement is not None
    assert again.number == good.number + 1


async def test_a_sphere_that_is_loose_makes_no_measurement() -> None:
    async with bench(mode="monitor") as at:
        outcomes = []
        await at.clock.run_until(2.0)
        for loose_um in (0.0, 20.0):
            at.control.nck.loose_um = loose_um
            cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
            await at.clock.run_until(at.clock.monotonic() + 250.0)
            assert cycle.done()
            outcomes.append(await cycle)
    firm, loose = outcomes
    assert firm.measurement is not None
    assert (loose.measurement, loose.end) == (None, End.REJECTED)
    assert "repeated touches of a point differ by" in loose.reason


@pytest.mark.parametrize("when", ["while it waits", "while it probes"])
async def test_an_emergency_stop_ends_the_measurement_with_its_reason(when: str) -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(10.0 if when == "while it waits" else 70.0)
        at.control.nck.raise_alarm(3000, at.clock.monotonic())
        await at.clock.run_until(80.0)
        outcome = await cycle
        assert at.link.present is not None
        assert at.link.present.alarms == (3000,)
        assert len(at.link.present.alarms) <= ALARMS_SHOWN
    assert outcome.measurement is None
    assert "an alarm is active" in outcome.reason


async def test_positions_that_freeze_while_the_axes_report_speed_are_used_no_longer() -> None:
    async with bench() as at:
        at.link.follow(wants(10.0))
        await at.clock.run_until(30.0)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)
        at.control.frozen = at.control.state()
        await at.clock.run_until(145.0)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)
        await at.clock.run_until(200.0)
        assert [text for text in at.told(ended=False) if "X report a speed and do not move" in text]
        assert at.steps[-1].step.source is Source.STALE
        np.testing.assert_allclose(at.shift(), 0.0, atol=1e-9)
        at.control.frozen = None
        await at.clock.run_until(230.0)
        assert at.told(ended=True) == ["NC: the axes move again"]
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)


@pytest.mark.parametrize("what", ["K0 when it connects", "K0 after a write", "a position"])
async def test_what_is_no_number_is_told_and_nothing_is_written_on_it(what: str) -> None:
    async with bench() as at:
        nck = at.control.nck
        if what == "K0 when it connects":
            nck.k0_mm[0] = math.nan
        at.link.follow(wants(40.0))
        await at.clock.run_until(10.0)
        write = nck.write_k0
        if what == "a position":
            state = at.control.state()
            at.control.frozen = replace(state, positions=state.positions | {"Y": math.nan})
        elif what == "K0 after a write":

            def spoil(axis: int, value_mm: float, now_s: float) -> None:
                write(axis, value_mm + math.nan, now_s)

            nck.write_k0 = spoil  # type: ignore[method-assign]
        await at.clock.run_until(12.0)
        wrote = len(nck.log)
        await at.clock.run_until(14.0)
        assert len(nck.log) == wrote
        assert [text for text in at.told(ended=False) if "nan: not a finite number" in text]
        at.control.frozen, nck.write_k0 = None, write  # type: ignore[method-assign]
        nck.k0_mm[:] = [0.0, 0.0, nck.k0_mm[2] if math.isfinite(nck.k0_mm[2]) else 0.0]
        await at.clock.run_until(100.0)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 40.0], atol=1e-9)


@pytest.mark.parametrize("subscribe_s", [0.0, 0.05])
async def test_a_control_whose_clock_is_an_hour_off_is_believed_in_our_time(subscribe_s: float) -> None:
    async with bench(subscribe_s=subscribe_s) as at:
        at.control.clock_wrong_by = timedelta(hours=-1)
        at.link.follow(wants(3.0))
        await at.clock.run_until(10.0)
        assert at.link.present is not None
        assert abs(at.link.present.time - at.clock.utc()) < timedelta(seconds=2)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 3.0], atol=1e-9)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(250.0)
        outcome = await cycle
        assert outcome.measurement is not None
        assert outcome.ended <= at.clock.utc()


async def test_a_user_who_may_not_write_is_told_which_right_is_missing_and_the_rest_goes_on(tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.write_text("secret")
    rights = frozenset(Right) - {Right.SEA_WRITE}
    async with bench(users={"gateway": User("secret", rights)}, password=password) as at:
        at.link.follow(wants(4.0))
        await at.clock.run_until(30.0)
        assert [text for text in at.told(ended=False) if "'gateway' the right SeaWrite" in text]
        np.testing.assert_allclose(at.shift(), 0.0)
        looks = at.control.looks
        await at.clock.run_until(330.0)
        assert len(at.notices) == 1, "it lasts, so it is told once, and not as connected each time"
        assert 8 <= (at.control.looks - looks) / 10.0 <= 15, "every 30 s a connection, with some reads each"


async def test_an_axis_without_a_position_is_told_once_and_its_end_once() -> None:
    async with bench(mode="monitor") as at:
        await at.clock.run_until(10.0)
        state = at.control.state()
        at.control.frozen = replace(state, positions=state.positions | {"A": math.nan})
        await at.clock.run_until(200.0)
        assert len(at.notices) == 1  # although all that is read when it connects, offsets in force too, is there
        assert "actToolBasePos[u1,4]" in at.told(ended=False)[0]
        at.control.frozen = None
        await at.clock.run_until(300.0)
        assert at.told(ended=True) == ["NC: connected again"]
        assert len(at.notices) == 2


async def test_monitoring_goes_on_while_another_gateway_has_the_control_and_nothing_is_written() -> None:
    async with bench(mode="monitor", owner=2) as at:
        nck = at.control.nck
        async with driver_of_the_other(at) as other:
            await at.clock.run_until(3.0)
            await other.heartbeat(1)
            await other.write_compensation((1.0, 2.0, 3.0))
            before, positions = list(nck.r), []
            at.link.follow(wants(9.0))
            for now in range(4, 30):
                await at.clock.run_until(float(now))
                assert await other.heartbeat(1)
                before[94] = nck.r[94]
                assert nck.r == before
                assert at.link.present is not None
                positions.append(at.link.present.positions["X"])
            assert len(set(positions)) > 20, "reads go on"
            assert at.told(ended=False) == []
            np.testing.assert_allclose(at.shift(), [1.0, 2.0, 3.0], atol=1e-9)
            assert at.steps[-1].step.offsets_um[2] > 5.0, "computed all the same"
            assert not any(step.written for step in at.steps)
            assert (await other.probing_status(1)).state is ProbingState.IDLE


@asynccontextmanager
async def driver_of_the_other(at: Bench) -> AsyncIterator[Sinumerik]:
    """A second gateway's connection, past the line that the first one uses; it has claimed the control."""
    other = Sinumerik(SinumerikSettings(url=f"opc.tcp://127.0.0.1:{at.line.target}"), at.clock)
    await other.connect()
    await other.claim(1, Watch(60.0, 1.0))
    try:
        yield other
    finally:
        await other.close()
