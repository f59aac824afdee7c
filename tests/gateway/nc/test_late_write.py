"""The network may hold a write that gets no answer, so that it arrives later.

It makes no step larger than one period's, and the gateway recognises its own write.
"""

import asyncio
import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise

import numpy as np
import pytest

from drivers.base import NoAnswer
from drivers.nc import Triple
from gateway.config.sections import Compensation
from gateway.model.compensation import Source, Write
from gateway.model.notice import Notice
from gateway.nc.lease import Lease
from gateway.nc.routes import form_of
from gateway.nc.settings import Identity
from gateway.nc.writer import OffsetWriter
from gateway.runtime.problems import Problems
from tests.benches.nc_link_bench import LinkBench, ScriptedControl, decision
from tests.benches.stepped_clock import SteppedClock

SLEW = 1.0
"""µm in a period of 1 s."""


@asynccontextmanager
async def losing() -> AsyncIterator[LinkBench]:
    """A gateway on its way to 25 µm in Z, whose next write, at 10 s, will be lost."""
    bench = LinkBench("compensate")
    bench.link.follow(decision(25.0))
    async with bench.running():
        await bench.clock.run_until(10.0)
        bench.control.loses = True
        yield bench


def lands(bench: LinkBench) -> float:
    """Let the lost write take effect; returns the step that it makes, µm."""
    late: Triple | None = bench.control.lost
    assert late is not None
    step = max(abs(a - b) for a, b in zip(late, bench.control.in_force, strict=True))
    bench.control.in_force = late
    return step


def sources(bench: LinkBench) -> list[str]:
    return [write.step.source.value for write in bench.steps]


async def test_the_offsets_stand_where_a_late_write_would_find_them_and_it_is_no_step() -> None:
    async with losing() as bench:
        await bench.clock.run_until(11.0)
        stood = bench.control.in_force
        await bench.clock.run_until(16.0)
        assert bench.control.in_force == stood, "nothing is written meanwhile"
        assert sources(bench)[-1] == "unanswered"
        assert 0.0 < lands(bench) <= SLEW
        await bench.clock.run_until(18.0)
        assert sources(bench)[-1] == "prediction", "it has been seen: the ramp goes on at once"
        await bench.clock.run_until(58.0)
        assert bench.control.in_force == (0.0, 0.0, 25.0)
        assert bench.link.armed
    shifts = [um[2] for _, um in bench.control.writes]
    assert max(b - a for a, b in zip([0.0, *shifts], shifts, strict=False)) <= 2 * SLEW, "the late one lies between"


async def test_a_write_that_never_arrives_holds_the_ramp_for_ten_seconds() -> None:
    async with losing() as bench:
        await bench.clock.run_until(11.0)
        stood = bench.control.in_force
        await bench.clock.run_until(20.0)
        assert bench.control.in_force == stood
        await bench.clock.run_until(26.0)
        assert bench.control.in_force[2] > stood[2] + 2.0
        await bench.clock.run_until(58.0)
        assert bench.control.in_force == (0.0, 0.0, 25.0)
    assert bench.link.armed
    times = [at for at, _ in bench.control.writes]
    longest = max(after - before for before, after in pairwise(times))
    assert longest == 11.0, "ten seconds after the lost write, which came a period after the one before"


@pytest.mark.parametrize(("told_s", "stands_s"), [(30.0, 30.0), (3600.0, 120.0), (5.0, 10.0)])
async def test_it_stands_for_as_long_as_the_control_would_take_the_write_within_two_minutes(
    told_s: float, stands_s: float
) -> None:
    async with losing() as bench:
        bench.control.late_write_s = told_s
        await bench.clock.run_until(11.0)
        stood = bench.control.in_force
        await bench.clock.run_until(10.0 + stands_s)
        assert bench.control.in_force == stood
        await bench.clock.run_until(13.0 + stands_s)
        assert bench.control.in_force[2] != stood[2], "towards the target again, or from it when that is stale"


async def test_a_driver_that_cannot_say_how_late_may_not_make_the_gateway_forget_the_write() -> None:
    async with losing() as bench:
        bench.control.late_write_s = math.nan
        await bench.clock.run_until(11.0)
        stood = bench.control.in_force
        await bench.clock.run_until(60.0)
        assert bench.control.in_force == stood, "it connected again, and writes nothing meanwhile"
        assert sources(bench)[-1] == "unanswered"
        assert 0.0 < lands(bench) <= SLEW


async def test_stopped_meanwhile_it_takes_the_offsets_back_at_once() -> None:
    async with losing() as bench:
        await bench.clock.run_until(16.0)
        assert sources(bench)[-1] == "unanswered"
        before = len(bench.control.writes)
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(18.0)
    assert len(bench.control.writes) > before
    await bench.clock.run_until(50.0)
    await stopping
    assert bench.control.in_force == (0.0, 0.0, 0.0)


async def test_a_late_write_of_which_the_control_took_a_part_is_still_its_own() -> None:
    bench = LinkBench("compensate")
    both = decision(25.0)
    both.corrected[0] = 25.0  # EY0A: at A = 0 the offset in Y
    bench.link.follow(both)
    async with bench.running():
        await bench.clock.run_until(10.0)
        bench.control.loses = True
        await bench.clock.run_until(40.0)
        assert bench.control.lost is not None
        _, y, z = bench.control.in_force
        assert bench.control.lost[2] < z - 2.0
        bench.control.in_force = (0.0, y, bench.control.lost[2])
        await bench.clock.run_until(58.0)
        assert bench.control.in_force == (0.0, 25.0, 25.0)
    assert bench.link.armed


async def test_later_than_that_it_is_still_known_as_its_own_and_the_ramp_goes_on_from_there() -> None:
    async with losing() as bench:
        await bench.clock.run_until(40.0)
        lands(bench)
        here = bench.control.in_force[2]
        before = len(bench.control.writes)
        await bench.clock.run_until(41.0)
        await bench.clock.run_until(42.0)
        assert abs(bench.control.writes[before][1][2] - here) <= SLEW + 1e-9, "from where it is"
        await bench.clock.run_until(58.0)
        assert bench.control.in_force == (0.0, 0.0, 25.0)
    assert bench.link.armed
    assert len([text for text in bench.notices if "arrived late; the ramp continues from there" in text]) == 1


async def test_what_another_program_sets_after_a_lost_write_still_disarms() -> None:
    async with losing() as bench:
        await bench.clock.run_until(40.0)
        bench.control.in_force = (5.0, 0.0, 3.0)
        await bench.clock.run_until(45.0)
        assert bench.control.in_force == (5.0, 0.0, 3.0)
    assert not bench.link.armed


async def test_a_process_that_stood_still_while_it_looked_for_a_late_write_connects_again() -> None:
    """watchdog_s = 10: after 6 s the control may be about to take the offsets away."""
    async with losing() as bench:
        await bench.clock.run_until(12.5)
        closed, written = bench.control.closed, len(bench.control.writes)
        bench.control.hangs = "look"
        await bench.clock.run_until(19.5)
        assert (bench.control.closed, len(bench.control.writes)) == (closed + 1, written)
        assert len([text for text in bench.notices if "since the heartbeat" in text]) == 1
        await bench.clock.run_until(58.0)
        assert bench.control.in_force == (0.0, 0.0, 25.0)
    assert bench.control.writes[written][1][2] <= 1.0 + SLEW, "from where the watchdog had them"
    assert bench.link.armed


async def test_after_a_write_without_an_answer_the_offsets_in_force_are_not_known() -> None:
    clock, settings = SteppedClock(), Compensation(mode="compensate")
    control, notices = ScriptedControl(clock), list[Notice]()
    problems = Problems(clock, 1.0, notices.append, logging.getLogger(__name__))
    lease = Lease(control, clock, Identity(), settings, problems, notices.append)
    form, stored = form_of(control, 0.12, (50.0, 50.0, 50.0)), list[Write]()
    writer = OffsetWriter(form, lease, clock, settings, 1.0, lambda: 0.0, stored.append)
    wanted = np.array([[0.0], [0.0], [9.0]])

    async def step() -> None:
        clock.spend(1.0)
        await lease.beat()
        snapshot = await control.snapshot()
        await writer.follow(clock.monotonic(), snapshot, wanted, Source.PREDICTION, 1, send=True)

    await lease.claim()
    await writer.begin()
    await step()
    assert writer.knows
    control.swallows = True
    with pytest.raises(NoAnswer):
        await step()
    assert not writer.knows


@pytest.mark.parametrize("halt_s", [0.3, 0.95])
async def test_after_a_halt_two_writes_are_a_period_apart(halt_s: float) -> None:
    """This process stands still between its decision and its write, so the next write is due soon after it."""
    bench = LinkBench("compensate")
    bench.link.follow(decision(25.0))
    async with bench.running():
        await bench.clock.run_until(5.0)
        bench.control.halts_s = halt_s
        await bench.clock.run_until(30.0)
        assert bench.control.halts_s == 0.0
    moved = [(at, um[2]) for at, um in bench.control.writes if at < 20.0]
    assert min(after[0] - before[0] for before, after in pairwise(moved)) >= 0.99
    assert bench.control.in_force == (0.0, 0.0, 25.0)
    assert bench.link.armed
