"""The link's state tables, and what the offsets do in each state."""

import asyncio

import numpy as np
import pytest

from drivers.nc import ProbingState, RequestStatus
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source
from gateway.nc.states import RIGHTS, STATES, Condition, LinkState, Reply, Right, after
from talc.frame import Why
from tests.benches.nc_link_bench import LinkBench, decision


def test_every_state_can_be_reached_and_a_lost_connection_ends_each_but_the_last() -> None:
    assert {then for row in STATES.values() for then in row.values()} == set(LinkState)
    for state, row in STATES.items():
        assert row.get(Condition.LOST, LinkState.AWAY) is LinkState.AWAY
        assert (Condition.CONNECTED in row) is (state is LinkState.AWAY)
    assert set(STATES[LinkState.STOPPING].values()) == {LinkState.STOPPING}


def test_from_disarmed_and_from_an_unarmed_mode_no_way_leads_to_a_write() -> None:
    for begin in (Right.DISARMED, Right.NONE):
        assert set(RIGHTS[begin].values()) == {begin}
    may_write = {right for right, row in RIGHTS.items() if row.get(Reply.HEARD) is Right.HEARD}
    assert may_write == {Right.UNHEARD, Right.HEARD}
    assert all(row[Reply.LOST] is not Right.HEARD for row in RIGHTS.values())
    assert [right for right, row in RIGHTS.items() if Reply.CLAIMED in row] == [Right.UNCLAIMED]


def test_what_cannot_happen_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="'heard' cannot happen in state 'disarmed'"):
        after(RIGHTS, Right.DISARMED, Reply.HEARD)
    with pytest.raises(RuntimeError, match="'clear' cannot happen in state 'stopping'"):
        after(STATES, LinkState.STOPPING, Condition.CLEAR)


@pytest.mark.parametrize("mode", ["monitor", "compensate"])
async def test_offsets_stand_still_while_another_client_has_the_control_probe(mode: str) -> None:
    bench = LinkBench(mode)
    async with bench.following(20.0, until_s=5.0):
        bench.control.probing = True
        before, stood = len(bench.control.writes), bench.steps[-1].step.offsets_um
        await bench.clock.run_until(15.0)
        assert bench.steps[-1].step.offsets_um == stood
        assert len(bench.control.writes) == before
        bench.control.probing = False
        await bench.clock.run_until(16.0)
        assert stood[2] < bench.steps[-1].step.offsets_um[2] <= stood[2] + 1.0, "nothing was saved up"
    assert [write.step.source for write in bench.steps].count(Source.FROZEN) == 1


async def test_a_cycle_that_nobody_waits_for_and_that_does_not_end_is_told_once() -> None:
    """The control was stopped in it, and nothing tells that it is over: what is in force would stay unnoticed."""
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(20.0))
        bench.control.probing = True
        await bench.clock.run_until(899.0)
        assert bench.notices == []
        await bench.clock.run_until(2000.0)
        assert [notice.code for notice in bench.notices] == [NoticeCode.NC_PROBES_ON]
        bench.control.probing = False
        await bench.clock.run_until(2003.0)
        assert bench.notices[-1].code == NoticeCode.NC_PROBES_NO_MORE
        bench.control.probing = True
        await bench.clock.run_until(2500.0)
        assert len(bench.notices) == 2, "its time begins anew"


async def test_while_the_control_is_not_ready_the_offsets_stand() -> None:
    bench = LinkBench("compensate")
    async with bench.following(20.0, until_s=5.0):
        bench.control.ready, bench.control.probing = False, True
        before, beats = len(bench.control.writes), len(bench.control.beats)
        await bench.clock.run_until(15.0)
        assert bench.steps[-1].step.source is Source.NOT_READY
        assert len(bench.control.writes) == before
        assert len(bench.control.beats) == beats + 10, "the lease is kept"
        bench.control.ready, bench.control.probing = True, False
        await bench.clock.run_until(18.0)
        heights = [offsets[2] for _, offsets in bench.control.writes[before - 1 :]]
    assert np.abs(np.diff(heights)).max() <= 1.0 + 1e-9, "nothing was saved up"
    assert heights[-1] > heights[0]


async def test_not_ready_while_it_stops_it_writes_nothing_more() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(10.0))
        await bench.clock.run_until(15.0)
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(18.5)
    assert 5.0 < bench.control.in_force[2] < 9.0
    bench.control.ready = False
    before = len(bench.control.writes)
    await bench.clock.run_until(60.0)
    ended = stopping.done()
    stopping.cancel()
    assert ended
    assert len(bench.control.writes) == before
    assert bench.steps[-1].step.source is Source.NOT_READY
    assert (bench.control.owner, bench.control.closed) == (0, 1)


async def test_stopped_after_an_emergency_stop_it_takes_back_what_is_in_force_by_then() -> None:
    bench = LinkBench("compensate")
    async with bench.following(5.0, until_s=10.0):
        bench.control.ready = False
        await bench.clock.run_until(12.0)
        bench.control.in_force = (0.0, 0.0, 2.0)  # the watchdog had the offsets, or the control was off
    bench.control.ready = True
    before = len(bench.control.writes)
    await bench.stopped(60.0)
    assert [offsets[2] for _, offsets in bench.control.writes[before:]] == [1.0, 0.0]
    assert bench.notices == []


async def test_a_cycle_that_begins_late_has_as_long_as_any_other() -> None:
    """Withdrawn while it runs, it would stop the part program with M0."""
    bench = LinkBench("monitor")
    bench.control.answer = RequestStatus(0, ProbingState.REQUESTED)
    async with bench.running():
        cycle = asyncio.create_task(bench.link.measure(Why.CALIBRATION))
        await bench.clock.run_until(800.0)
        bench.control.answer = None  # it runs
        await bench.clock.run_until(1100.0)
        bench.control.answer = RequestStatus(0, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
        await bench.clock.run_until(1200.0)
        assert (await cycle).measurement is not None
    assert bench.control.withdrawn == []
