"""The driver of route `errors` over OPC UA, on an emulated control that runs the generated program, or does not."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from drivers.base import BadAnswer, Refused
from drivers.nc import FollowsErrors, NineErrors, NotSendable, ProbingState, WatchdogTerms
from drivers.sinumerik.errors import SinumerikWithErrors
from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.programs import errors_program
from drivers.sinumerik.settings import Paths
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads
from tests.benches.emulated_bench import Rigid
from tests.benches.error_program import (
    BOUND_UM,
    ECHO,
    IN_FORCE,
    R_COUNT,
    RADIUS_MM,
    SLEW_UM_PER_S,
    STATE,
    TERMS,
    WANTED,
    WARM,
    program,
    settings,
)
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time

WATCH = WatchdogTerms(4.0, SLEW_UM_PER_S)
SENT = NineErrors(tuple(WARM), RADIUS_MM, BOUND_UM)
OF_PROGRAM, TOOL = 99, 135


@asynccontextmanager
async def control(
    *programs: str, r_count: int = R_COUNT, **changes: Any
) -> AsyncIterator[tuple[EmulatedControl, SinumerikWithErrors, ManualClock]]:
    clock = ManualClock()
    day = LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, MeanLoads())], operation_s=40.0)
    cycle = CycleSettings(noise_um=0.0)
    emulated = EmulatedControl(Rigid(), clock, day, cycle=cycle, programs=programs, r_count=r_count)
    nc = SinumerikWithErrors(settings(await emulated.start()).model_copy(update=changes), clock)
    try:
        yield emulated, nc, clock
    finally:
        await nc.close()
        await emulated.stop()


def test_it_follows_the_errors_as_the_gateway_asks() -> None:
    follows: FollowsErrors = SinumerikWithErrors(settings(), ManualClock())
    assert isinstance(follows, FollowsErrors), "otherwise it would get shifts"
    assert isinstance(make_sinumerik(settings(), ManualClock()), SinumerikWithErrors)


async def test_the_nine_are_written_and_read_and_take_effect_at_the_slew() -> None:
    async with control(program()) as (emulated, nc, clock):
        await nc.connect()
        assert nc.error_reach_mm == pytest.approx((240.0, 348.281), abs=1e-3)
        await nc.claim(7, WATCH)
        clock.move_to(1.0)
        assert await nc.heartbeat(7)
        await nc.write_errors(SENT)
        assert await nc.read_errors(RADIUS_MM) == pytest.approx(tuple(WARM))
        assert (await nc.read_errors(2 * RADIUS_MM))[5] == pytest.approx(2 * WARM[5])
        clock.move_to(2.0)
        await nc.read_errors(RADIUS_MM)
        assert 0 < np.abs(emulated.nck.r[IN_FORCE : IN_FORCE + 9]).max() < 1.0
        with pytest.raises(NotSendable, match="largest_um"):
            await nc.write_errors(NineErrors((501.0,) + (0.0,) * 8, RADIUS_MM, BOUND_UM))
        await nc.write_compensation((3.0, 4.0, 5.0))
        clock.move_to(10.0)
        await nc.snapshot()
        assert emulated.nck.shift_um((0.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0)), "no beat for too long"
        assert emulated.nck.r[WANTED : WANTED + 9] == [0.0] * 9
        assert emulated.nck.r[STATE] == 2.0


async def test_no_cycle_begins_while_offsets_move_that_no_gateway_holds() -> None:
    async with control(program()) as (emulated, nc, clock):
        await nc.connect()
        await nc.claim(7, WATCH)
        clock.move_to(1.0)
        await nc.heartbeat(7)
        await nc.write_compensation((0.0, 0.0, 1.0))
        clock.move_to(5.5)
        assert await nc.read_errors(RADIUS_MM) == (0.0,) * 9, "the gateway is silent: nothing is wanted any more"
        assert max(map(abs, emulated.nck.shift_um((0.0, 0.0, 0.0)))) > 0.1
        with pytest.raises(Refused, match="they would move in the cycle"):
            await nc.request_probing(41)
        clock.move_to(8.0)
        await nc.request_probing(41)


@pytest.mark.slow
async def test_what_stood_still_while_it_probed_comes_with_the_result() -> None:
    async with control(program()) as (_, nc, clock):
        await nc.connect()
        await nc.claim(7, WatchdogTerms(1e4, SLEW_UM_PER_S))
        clock.move_to(1.0)
        await nc.heartbeat(7)
        await nc.write_compensation((3.0, 4.0, 5.0))
        clock.move_to(20.0)
        await nc.request_probing(41)
        clock.move_to(60.0)
        await nc.snapshot()
        clock.move_to(100.0)
        await nc.write_compensation((0.0, 0.0, 0.0))
        clock.move_to(400.0)
        status = await nc.probing_status(41)
        assert status.state is ProbingState.DONE
        assert status.in_force_um == pytest.approx((3.0, 4.0, 5.0))
        assert status.centres_mm is not None
        assert status.centres_mm[0] == pytest.approx((120.0 - 10.0 - 3e-3, 20.0 - 4e-3, 80.0 - 30.0 - 5e-3))


@pytest.mark.slow
async def test_a_control_without_the_program_gets_shifts() -> None:
    async with control(r_count=100) as (emulated, nc, clock):
        await nc.connect()
        assert nc.error_reach_mm is None
        await nc.claim(7, WATCH)
        clock.move_to(1.0)
        assert await nc.heartbeat(7)
        await nc.write_compensation((3.0, 4.0, 5.0))
        assert emulated.nck.k0_mm == pytest.approx([-3e-3, -4e-3, -5e-3])
        assert await nc.read_compensation() == pytest.approx((3.0, 4.0, 5.0))
        with pytest.raises(Refused, match="no TALC_ERRORS"):
            await nc.write_errors(SENT)


async def test_a_program_for_other_data_is_refused_by_name() -> None:
    async with control(program(slew_um_per_s=2.0, bound_um=(60.0, 50.0, 71.0))) as (emulated, nc, _):
        await nc.connect()
        for ramp_um_per_s in (1.0, 0.0):  # when_stale = "zero" or "hold"
            with pytest.raises(Refused, match=r"slews at 2 µm/s, the configuration at 1.*sinumerik-files"):
                await nc.claim(7, WatchdogTerms(4.0, ramp_um_per_s, slew_um_per_s=1.0))
        await nc.claim(7, WatchdogTerms(4.0, 0.0, slew_um_per_s=2.0))
        with pytest.raises(NotSendable, match=r"71\.0.*nothing was sent.*sinumerik-files"):
            await nc.write_errors(SENT)
        assert emulated.nck.r[WANTED : WANTED + 9] == [0.0] * 9
        emulated.nck.r[OF_PROGRAM] = 1.0
        with pytest.raises(BadAnswer, match="version 1: expected 3"):
            await nc.connect()
        emulated.nck.r[OF_PROGRAM], emulated.nck.r[125] = 3.0, 0.0
        with pytest.raises(BadAnswer, match="a term of 0 or less"):
            await nc.connect()


async def test_without_its_program_a_gantry_gets_no_offset() -> None:
    gantry = settings().compensation.model_copy(update={"synchronised": {"X": "X2"}})
    async with control(compensation=gantry) as (_, nc, _):
        with pytest.raises(Refused, match="the axes of a gantry would not get the same offset"):
            await nc.connect()


async def test_the_length_of_the_tool_in_use_shifts_the_positions_and_reaches_the_program() -> None:
    read: dict[str, Any] = {"nodes": Paths(tool_length="/Channel/State/actToolLength1[u1]"), "origin_tool_mm": 80.0}
    program_with_tool = errors_program(settings().model_copy(update=read), TERMS)
    async with control(program(), **read) as (_, nc, _):
        with pytest.raises(Refused, match=r"-300 mm .* 300 mm"):
            await nc.connect()
    async with control(program_with_tool, **read) as (emulated, nc, clock):
        await nc.connect()
        await nc.claim(7, WATCH)
        clock.move_to(1.0)
        assert await nc.heartbeat(7)
        heights = []
        for length in (80.0, 180.0, 0.0, 50.0):
            emulated.nck.tool_length_mm = length
            heights.append((await nc.snapshot()).positions["Z"])
            await nc.write_errors(SENT)
        assert np.array(heights) - heights[0] == pytest.approx([0.0, -100.0, -100.0, 30.0]), "D0 counts as no change"
        assert emulated.nck.r[TOOL] == -30.0
        for wrong in (400.0, float("nan")):
            emulated.nck.tool_length_mm = wrong
            with pytest.raises(BadAnswer, match="actToolLength1"):
                await nc.snapshot()


async def test_within_a_cycle_the_tip_is_the_probe_s_and_not_the_part_program_s() -> None:
    read: dict[str, Any] = {"nodes": Paths(tool_length="/Channel/State/actToolLength1[u1]"), "origin_tool_mm": 80.0}
    async with control(**read) as (emulated, nc, clock):
        await nc.connect()
        await nc.request_probing(1)
        clock.move_to(41.0)  # the safe point was at 40
        heights = []
        for length in (80.0, 30.0, 0.0):
            emulated.nck.tool_length_mm = length
            snapshot = await nc.snapshot()
            assert snapshot.probing
            heights.append(snapshot.positions["Z"])
        assert np.array(heights) - heights[0] == pytest.approx([0.0, 50.0, 0.0])


async def test_a_program_that_reads_the_length_of_the_tool_needs_no_node_and_an_impossible_one_is_told() -> None:
    async with control(
        errors_program(settings(), TERMS), nodes=Paths(tool_length="/Channel/State/actToolLength1[u1]")
    ) as (
        _,
        nc,
        _,
    ):
        with pytest.raises(Refused, match=r"-300 mm .* 300 mm"):
            await nc.connect()
    async with control(program()) as (emulated, nc, clock):
        await nc.connect()
        await nc.claim(7, WATCH)
        clock.move_to(1.0)
        assert await nc.heartbeat(7)
        heights = []
        for length in (0.0, 100.0, 0.0):
            emulated.nck.tool_length_mm = length
            clock.move_to(clock.monotonic() + 1.0)
            assert await nc.heartbeat(7)
            await nc.read_errors(RADIUS_MM)
            await nc.write_errors(SENT)
            heights.append((await nc.snapshot()).positions["Z"])
        assert np.array(heights) - heights[0] == pytest.approx([0.0, -100.0, -100.0]), "D0 counts as no change"
        emulated.nck.tool_length_mm = 400.0
        clock.move_to(clock.monotonic() + 1.0)
        with pytest.raises(BadAnswer, match="= 400: a tool 400 mm longer than that of the origin"):
            await nc.heartbeat(7)


@pytest.mark.slow
async def test_a_program_that_no_longer_runs_to_its_end_hears_no_beat() -> None:
    async with control(program()) as (emulated, nc, clock):
        await nc.connect()
        await nc.claim(7, WATCH)
        heard = []
        for second in range(1, 8):
            clock.move_to(float(second))
            heard.append(await nc.heartbeat(7))
            if second == 3:  # somebody has cancelled its last action
                run = emulated.nck.main_run
                assert run is not None
                run.actions.cancel(max(run.actions.numbers))
        assert heard == [True, True, True, False, False, False, False]
        assert emulated.nck.r[ECHO] == 4.0, "the last beat before"
