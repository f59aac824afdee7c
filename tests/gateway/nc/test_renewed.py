"""A correction that is renewed between two decisions reaches the NC as a decision does.

Whatever keeps a decision from the NC also keeps the renewal from it.
"""

import asyncio
import math
from itertools import pairwise

import numpy as np
import pytest

from drivers.nc import ProbingState, RequestStatus
from gateway.model.commands import Disarmed, Pause
from gateway.model.compensation import Source
from talc.frame import FloatArray, Why
from tests.benches.nc_link_bench import LinkBench, decision
from tests.benches.stepped_clock import EPOCH

PERIOD_S, SLEW_UM = 1.0, 1.0


def corrected(ez0a: float) -> FloatArray:
    return decision(ez0a).corrected


async def renew_each_second(bench: LinkBench, until_s: float, ez0a: float) -> None:
    while (now_s := bench.clock.monotonic()) < until_s:
        bench.link.renew(corrected(ez0a))
        await bench.clock.run_until(min(now_s + PERIOD_S, until_s))


def z_of(bench: LinkBench) -> list[float]:
    return [offsets[2] for _, offsets in bench.control.writes]


@pytest.mark.parametrize("ez0a", [-1e300, -300.0, 300.0, 1e300, math.inf])
async def test_no_renewal_steps_or_leaves_the_bound(ez0a: float) -> None:
    bench = LinkBench("compensate", stale_after_s=600.0)
    async with bench.following(4.0, until_s=10.0):
        await renew_each_second(bench, 70.0, ez0a)
    assert max(abs(b - a) for a, b in pairwise(z_of(bench))) <= SLEW_UM + 1e-9
    assert max(map(abs, z_of(bench))) <= 50.0
    assert bench.control.in_force[2] == math.copysign(50.0, ez0a)


async def test_renewals_do_not_keep_a_decision_alive() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await renew_each_second(bench, 60.0, 5.0)
        assert bench.control.in_force == (0.0, 0.0, 5.0)
        await renew_each_second(bench, 80.0, 5.0)
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert bench.steps[-1].step.source is Source.STALE


async def test_a_renewal_that_is_not_known_takes_the_offset_back() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.link.renew(np.full(9, np.nan))
        await bench.clock.run_until(20.0)
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert bench.steps[-1].step.source is Source.NO_MODEL


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_unarmed_no_renewal_is_written(mode: str) -> None:
    bench = LinkBench(mode)
    async with bench.running():
        bench.link.follow(decision(4.0))
        await renew_each_second(bench, 30.0, 6.0)
    assert bench.control.writes == []
    assert bench.steps[-1].step.offsets_um == (0.0, 0.0, 6.0), "computed all the same"


@pytest.mark.parametrize("whose", ["own", "the control's", "not ready"])
async def test_offsets_that_stand_still_do_so_whatever_is_renewed_and_then_move_on_by_the_slew(whose: str) -> None:
    bench = LinkBench("compensate", stale_after_s=600.0)
    bench.control.answer = RequestStatus(0, ProbingState.RUNNING)
    async with bench.following(4.0, until_s=10.0):
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL)) if whose == "own" else None
        bench.control.probing, bench.control.ready = whose == "the control's", whose != "not ready"
        await bench.clock.run_until(12.0)
        before = len(bench.control.writes)
        await renew_each_second(bench, 30.0, 9.0)
        assert len(bench.control.writes) == before
        assert bench.control.in_force == (0.0, 0.0, 4.0)
        bench.control.probing, bench.control.ready = False, True
        if cycle is not None:
            bench.control.answer = RequestStatus(0, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
            await renew_each_second(bench, 60.0, 9.0)
            assert cycle.done()
        await renew_each_second(bench, 80.0, 9.0)
    assert max(abs(b - a) for a, b in pairwise(z_of(bench))) <= SLEW_UM + 1e-9
    assert bench.control.in_force == (0.0, 0.0, 9.0)


async def test_without_the_right_to_write_no_renewal_is_written() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.control.owner = 999
        await bench.clock.run_until(12.0)
        before = len(bench.control.writes)
        await renew_each_second(bench, 40.0, 9.0)
    assert len(bench.control.writes) == before


@pytest.mark.parametrize("order", ["pause", "disarm"])
async def test_no_renewal_ends_a_pause_or_arms_the_gateway(order: str) -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        if order == "pause":
            bench.link.pause(Pause("anna", EPOCH))
        else:
            bench.link.disarm(Disarmed("anna", EPOCH))
        await renew_each_second(bench, 40.0, 9.0)
    assert bench.control.in_force == (0.0, 0.0, 0.0)
