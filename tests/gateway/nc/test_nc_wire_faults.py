"""Faults between the gateway's link and a control over its real protocol, and the link's reaction to them.

Faults that concern only the driver are in tests/drivers/sinumerik/test_sinumerik_faults.py, _security.py and
_subscription.py.
"""

import asyncio
import math
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import ProbingState
from gateway.model.compensation import Source
from gateway.model.probing import End
from simulators.nc import ReasonCode, User
from simulators.nc.variables import AccessRight
from talc.frame import Why
from tests.benches.nc_wire_bench import SLEW_UM_PER_S, bench, driver_of_the_other, wants

pytestmark = pytest.mark.simulated_time


@pytest.mark.slow
async def test_a_connection_lost_in_the_middle_of_a_write_leaves_no_step_behind() -> None:
    async with bench() as at:
        at.link.follow(wants(40.0))
        await at.clock.run_until(10.0)
        write = at.control.nck.write_k0
        written: list[int] = []

        def cut_after_the_first_axis(axis: int, value_mm: float, now_s: float) -> None:
            if not written:
                written.append(axis)
                at.wire.abort()
            write(axis, value_mm, now_s)

        at.control.nck.write_k0 = cut_after_the_first_axis  # type: ignore[method-assign]
        await at.clock.run_until(100.0)
        assert written
        assert len(at.told(ended=False)) == len(at.told(ended=True)) == 1
        assert at.link.armed
        assert at.jumps_um() <= SLEW_UM_PER_S + 1e-6
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 40.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("while_it", ["writes", "probes"])
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
        await at.clock.run_until(400.0 if while_it == "probes" else 100.0)
        assert len(at.told(ended=False)) == len(at.told(ended=True)) == 1
        assert at.link.armed
        assert at.jumps_um() <= SLEW_UM_PER_S + 1e-6
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 40.0], atol=1e-9)
        if cycle is not None:
            assert (await cycle).end is End.REFUSED
            assert nck.cycle.answer.reason is ReasonCode.WITHDRAWN
            assert at.written_meanwhile() == []


@pytest.mark.slow
async def test_positions_that_freeze_while_the_axes_report_speed_are_used_no_longer() -> None:
    async with bench() as at:
        at.link.follow(wants(10.0))
        await at.clock.run_until(30.0)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)
        at.control.frozen = at.control.state()
        await at.clock.run_until(145.0)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)
        await at.clock.run_until(200.0)
        assert (
            "NC: X report a speed and do not move; the control's values are frozen and not used: restart the server or "
            "agent that reports them"
        ) in at.told(ended=False)
        assert at.steps[-1].step.source is Source.STALE
        np.testing.assert_allclose(at.shift(), 0.0, atol=1e-9)
        at.control.frozen = None
        await at.clock.run_until(230.0)
        assert at.told(ended=True) == ["NC: no axis is frozen any more"]
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 10.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["K0 when it connects", "K0 after a write", "a position"])
async def test_what_is_not_a_number_is_reported_and_no_write_rests_on_it(what: str) -> None:
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


@pytest.mark.slow
async def test_values_of_a_control_whose_clock_is_an_hour_off_get_our_time() -> None:
    async with bench(subscribe_s=0.05) as at:
        at.control.clock_wrong_by = timedelta(hours=-1)
        at.link.follow(wants(3.0))
        await at.clock.run_until(10.0)
        assert at.link.present is not None
        assert abs(at.link.present.time - at.clock.utc()) < timedelta(seconds=2)
        np.testing.assert_allclose(at.shift(), [0.0, 0.0, 3.0], atol=1e-9)
        outcome = await at.measured(250.0)
        assert outcome.measurement is not None
        assert outcome.ended <= at.clock.utc()


async def test_the_right_that_a_user_lacks_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.write_text("secret")
    rights = frozenset(AccessRight) - {AccessRight.SEA_WRITE}
    async with bench(users={"gateway": User("secret", rights)}, password=password) as at:
        at.link.follow(wants(4.0))
        await at.clock.run_until(30.0)
        assert [text for text in at.told(ended=False) if "'gateway' the right SeaWrite" in text]
        np.testing.assert_allclose(at.shift(), 0.0)
        looks = at.control.looks
        await at.clock.run_until(330.0)
        assert len(at.notices) == 1, "it lasts, so it is reported once, and not as connected each time"
        assert 8 <= (at.control.looks - looks) / 10.0 <= 20, "every 30 s a connection, with some reads each"


@pytest.mark.slow
async def test_an_axis_without_a_position_is_reported_once_and_its_end_once() -> None:
    async with bench(mode="monitor") as at:
        await at.clock.run_until(10.0)
        state = at.control.state()
        at.control.frozen = replace(state, positions=state.positions | {"A": math.nan})
        await at.clock.run_until(200.0)
        assert len(at.notices) == 1  # although all that is read at connecting is there
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
                before[68] = before[94] = nck.r[94]
                assert nck.r == before
                assert at.link.present is not None
                positions.append(at.link.present.positions["X"])
            assert len(set(positions)) > 20, "reads go on"
            assert at.told(ended=False) == []
            np.testing.assert_allclose(at.shift(), [1.0, 2.0, 3.0], atol=1e-9)
            assert at.steps[-1].step.offsets_um[2] > 5.0, "computed all the same"
            assert not any(step.written for step in at.steps)
            assert (await other.probing_status(1)).state is ProbingState.IDLE
