"""Offsets that moved while the link did not write: it starts from where they are, or leaves them alone."""

import asyncio
from itertools import pairwise

import numpy as np
import pytest

from gateway.model.commands import Disarmed
from gateway.model.compensation import Source
from tests.benches.nc_link_bench import LinkBench, decision


async def test_a_process_that_stood_still_between_its_first_beat_and_its_first_write_does_not_write() -> None:
    bench = LinkBench("compensate", in_force=(0.0, 0.0, 5.0))
    bench.control.hangs = "beat"  # the watchdog takes 4 µm away meanwhile
    async with bench.running():
        bench.link.follow(decision(8.0))
        await bench.clock.run_until(40.0)
    heights = [1.0, *(offsets[2] for _, offsets in bench.control.writes)]
    assert np.abs(np.diff(heights)).max() <= 1.0 + 1e-9
    assert heights[-1] == 8.0
    assert any("since the heartbeat" in notice for notice in bench.notices)


async def test_it_begins_from_what_moved_while_the_control_was_not_ready_and_reports_no_other_writer() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.control.ready = False
        await bench.clock.run_until(12.0)
        bench.control.in_force = (0.0, 0.0, 0.0)  # off and on again
        await bench.clock.run_until(14.0)
        bench.control.ready = True
        before = len(bench.control.writes)
        await bench.clock.run_until(30.0)
    assert bench.link.armed
    assert bench.notices == []
    heights = [0.0, *(offsets[2] for _, offsets in bench.control.writes[before:])]
    assert np.diff(heights).max() <= 1.0 + 1e-9
    assert heights[-1] == 4.0


@pytest.mark.parametrize("meanwhile", ["not ready", "probed by somebody else"])
async def test_stopped_it_takes_back_what_is_in_force_and_not_what_it_remembers(meanwhile: str) -> None:
    bench = LinkBench("compensate", in_force=(0.0, 0.0, 5.0))
    if meanwhile == "not ready":
        bench.control.ready = False
    else:
        bench.control.probing = True
    async with bench.following(8.0, until_s=10.0):
        bench.control.in_force = (0.0, 0.0, 2.0)
    bench.control.ready, bench.control.probing = True, False
    await bench.stopped(60.0)
    assert [offsets[2] for _, offsets in bench.control.writes] == [1.0, 0.0]
    assert bench.notices == []


async def test_stopped_after_the_control_was_not_ready_it_takes_back_what_is_in_force_and_not_what_it_wrote() -> None:
    bench = LinkBench("compensate")
    async with bench.following(8.0, until_s=20.0):
        bench.control.ready = False
        await bench.clock.run_until(22.0)
        bench.control.in_force = (0.0, 0.0, 2.0)
    bench.control.ready, before = True, len(bench.control.writes)
    await bench.stopped(60.0)
    assert [offsets[2] for _, offsets in bench.control.writes[before:]] == [1.0, 0.0]
    assert bench.notices == []


async def test_stopped_without_the_watchdogs_ear_it_writes_nothing_more() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
    bench.control.watching = False
    before = len(bench.control.writes)
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(60.0)
    ended = stopping.done()
    stopping.cancel()
    assert ended
    assert len(bench.control.writes) == before
    assert (bench.control.owner, bench.control.closed) == (0, 1)


@pytest.mark.parametrize(("by_um", "armed"), [(0.04, True), (0.06, False), (-0.04, True), (-0.06, False)])
async def test_what_differs_by_more_than_a_twentieth_of_a_micrometre_is_of_another_writer(
    by_um: float, armed: bool
) -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.control.in_force = (0.0, by_um, 4.0)
        await bench.clock.run_until(15.0)
        assert bench.link.armed is armed


async def test_stopped_with_hold_it_leaves_the_offsets_where_they_are() -> None:
    bench = LinkBench("compensate", when_stale="hold")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
    before = len(bench.control.writes)
    await bench.stopped(30.0)
    assert len(bench.control.writes) == before
    assert bench.control.in_force == (0.0, 0.0, 4.0)
    assert bench.control.owner == 0


async def test_stopped_while_it_is_disarmed_it_takes_them_to_zero_also_with_hold() -> None:
    bench = LinkBench("compensate", when_stale="hold")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        bench.link.disarm(Disarmed("anna", bench.clock.utc()))
        await bench.clock.run_until(11.0)
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(30.0)
    await stopping
    assert [offsets[2] for _, offsets in bench.control.writes][-4:] == [3.0, 2.0, 1.0, 0.0]
    assert bench.control.owner == 0


@pytest.mark.parametrize("meanwhile", ["a spoilt answer", "another program"])
async def test_a_ramp_that_waited_for_a_cycle_begins_from_what_is_in_force_then(meanwhile: str) -> None:
    bench = LinkBench("compensate")
    bench.control.probing, bench.control.garbled = True, {1} if meanwhile == "a spoilt answer" else set()
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(60.0)
        if meanwhile == "another program":
            bench.control.in_force = (0.0, 0.0, 30.0)
        begins = bench.control.in_force
        await bench.clock.run_until(70.0)
        bench.control.probing = False
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(110.0)
    values = [begins, *(offsets for _, offsets in bench.control.writes)]
    assert all(abs(a - b) <= 1.0 for one, two in pairwise(values) for a, b in zip(one, two, strict=True))
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_step_says_when_the_control_cannot_be_reached_any_more() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        assert (bench.steps[-1].written, bench.steps[-1].step.source) == (True, Source.PREDICTION)
        bench.control.absent = True
        await bench.clock.run_until(20.0)
        assert (bench.steps[-1].written, bench.steps[-1].step.source) == (False, Source.AWAY)
        bench.control.absent = False
        await bench.clock.run_until(60.0)
        assert (bench.steps[-1].written, bench.steps[-1].step.source) == (True, Source.PREDICTION)
