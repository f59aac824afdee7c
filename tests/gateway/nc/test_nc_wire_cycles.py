"""Faults over the real protocol around a probing cycle, and the link's reaction to them."""

import asyncio
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from drivers.nc import ProbingState
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.model.probing import End
from simulators.nc import ReasonCode
from simulators.nc.nck import R_REQUEST, R_WITHDRAW
from simulators.nc.variables import ALARMS_SHOWN
from talc.frame import Why
from tests.benches.nc_wire_bench import CYCLE, bench, wants

pytestmark = pytest.mark.simulated_time


@pytest.mark.slow
@pytest.mark.parametrize(
    ("left_by", "looks"), [("a connection that is lost", True), ("a gateway that is killed", False)]
)
async def test_a_cycle_that_nobody_waits_for_is_withdrawn_and_the_offsets_stand_until_it_ends(
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
        if left_by == "a connection that is lost":
            await at.wire.cut()
            at.wire.silent = True
            await at.clock.run_until(66.0)
            at.wire.silent = False
        else:
            cycle.cancel()  # the next run takes back what this one asked for
        await at.clock.run_until(220.0)
        await asyncio.gather(cycle, return_exceptions=True)
        assert nck.r[R_WITHDRAW] == 41.0
        assert len(nck.cycle.ended) == 1
        (began, ended), answer = nck.cycle.ended[0], nck.cycle.answer
        assert ended - began > 100.0 if not looks else answer.reason is ReasonCode.WITHDRAWN
        assert at.written_meanwhile() == []
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 25.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["monitor", "compensate"])
async def test_offsets_stand_still_also_while_another_client_has_the_control_probe(mode: str) -> None:
    async with bench(mode=mode) as at:
        nck = at.control.nck
        at.link.follow(wants(5.0))
        other = Sinumerik(SinumerikSettings(security="none", url=f"opc.tcp://127.0.0.1:{at.wire.target}"), at.clock)
        await at.clock.run_until(12.0)
        await other.connect()
        await other.request_probing(900)
        ours = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(20.0)
        refused = ours.result()
        at.link.follow(wants(25.0))
        await at.clock.run_until(60.0)
        assert nck.cycle.started_s is not None
        at.link.follow(wants(35.0))  # the ramp to 25 may have ended before the cycle began
        again = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(65.0)
        assert again.result().end is refused.end is End.REFUSED
        await at.clock.run_until(220.0)
        assert (await other.probing_status(900)).state is ProbingState.DONE
        await other.close()
        assert "request 900 waits" in refused.reason
        assert "cycle 900 is in progress" in (await again).reason
        assert at.written_meanwhile() == []
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 35.0 if mode == "compensate" else 0.0], atol=1e-9)


async def test_a_gateway_displaced_by_a_request_of_the_same_moment_does_not_wait_for_it() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        cycle = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(4.0)
        at.control.nck.write_r(R_REQUEST, 900.0, at.clock.monotonic())
        await at.clock.run_until(20.0)
        assert cycle.done()
        outcome = await cycle
    assert (outcome.measurement, outcome.end) == (None, End.REFUSED)
    assert "is another gateway probing?" in outcome.reason


@pytest.mark.slow
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


@pytest.mark.slow
async def test_a_slope_that_the_gateway_does_not_know_makes_no_measurement() -> None:
    async with bench(mode="monitor") as at:
        at.control.nck.slope[0] = 1e-3  # 1 µm per mm of X, and the poses differ in X
        await at.clock.run_until(2.0)
        found = await at.ended(asyncio.create_task(at.link.measure(Why.INTERVAL)), 398.0)
    assert (found.measurement, found.end) == (None, End.REJECTED)
    assert "the offsets moved while the control probed" in found.reason


@pytest.mark.slow
async def test_a_result_that_comes_too_late_is_never_taken_for_the_next_one() -> None:
    async with bench() as at:
        await at.clock.run_until(2.0)
        at.control.nck.cycle.withdraw = lambda *_: None  # type: ignore[method-assign]  # the NC program does not look
        at.control.nck.cycle._settings = replace(CYCLE, duration_s=450.0)  # noqa: SLF001 - a feed override of 25 %
        late = await at.measured(360.0)
        second = asyncio.create_task(at.link.measure(Why.INTERVAL))
        await at.clock.run_until(520.0)  # now the first one is done
        refused = await second
        assert at.control.nck.cycle.answer.number == late.number
        assert at.control.nck.cycle.answer.centres_mm
        at.control.nck.cycle._settings = CYCLE  # noqa: SLF001
        found = await at.measured(780.0)
    assert late.measurement is None
    assert "did not end within 300 s" in late.reason
    assert found.measurement is not None
    assert f"cycle {late.number} is in progress" in refused.reason
    assert found.number == late.number + 2
    assert found.ended - found.asked > timedelta(seconds=100)


@pytest.mark.slow
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
