"""What reaches the NC: nothing unless armed, never a step, and nothing that the control does not confirm."""

import asyncio
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.nc import NcSnapshot, ProbingState, RequestStatus
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source
from gateway.model.probing import End
from talc.frame import Why
from tests.benches.nc_link_bench import LinkBench, decision


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_unarmed_nothing_is_ever_written(mode: str) -> None:
    bench = LinkBench(mode)
    async with bench.running():
        bench.link.follow(decision(20.0))
        await bench.clock.run_until(30.0)
    await bench.stopped(90.0)
    assert bench.control.writes == []
    assert bench.control.beats == []
    assert bench.control.owner == 0
    assert bench.steps[-1].step.offsets_um == (0.0, 0.0, 20.0)  # computed all the same
    assert not any(step.written for step in bench.steps)


async def test_unarmed_probing_asks_for_nothing() -> None:
    bench = LinkBench("compensate", armed=False)
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert not bench.link.may_probe
        assert bench.link.present is not None
    assert bench.control.requests == []


async def test_before_a_dry_run_no_cycle_is_requested_whoever_wants_one() -> None:
    bench = LinkBench("compensate", proven=False)
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert bench.link.may_probe
        assert bench.link.barrier
        outcome = await bench.link.measure(Why.COMMAND)
    assert outcome.end is End.REFUSED
    assert bench.control.requests == []


async def test_armed_it_ramps_from_what_is_in_force_and_never_steps() -> None:
    bench = LinkBench("compensate", in_force=(3.0, 0.0, -5.0))
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert bench.steps[-1].k == 5, "of the decision"
    before = np.array([3.0, 0.0, -5.0])
    for _, offsets in bench.control.writes:
        assert (np.abs(np.array(offsets) - before) <= 1.0 + 1e-9).all()
        before = np.array(offsets)
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_stale_prediction_decays_to_the_declared_value() -> None:
    to_zero, held = LinkBench("compensate"), LinkBench("compensate", when_stale="hold")
    for bench in (to_zero, held):
        async with bench.running():
            bench.link.follow(decision(4.0))
            await bench.clock.run_until(100.0)
        assert bench.steps[-1].step.source is Source.STALE
    assert to_zero.control.in_force == (0.0, 0.0, 0.0)
    assert held.control.in_force == (0.0, 0.0, 4.0)


@pytest.mark.parametrize("measured_s", [None, -150.0, -math.inf])
@pytest.mark.parametrize("when_stale", ["zero", "hold"])
async def test_an_error_without_a_model_is_corrected_by_its_last_measurement_for_a_limited_time(
    when_stale: str, measured_s: float | None
) -> None:
    """measured_s: when an earlier run measured; the present run begins at 0."""
    measured = None if measured_s is None else [measured_s] * 9
    bench = LinkBench("compensate", when_stale=when_stale, measured=measured, measurement_stale_after_s=200.0)
    predicted = np.full(9, math.nan)
    predicted[0] = 3.0  # EY0A has a model; EZ0A was measured once
    known = replace(decision(7.0), predicted=predicted)
    known.corrected[0] = 3.0
    found = {}
    async with bench.running():
        for now in range(20, 400, 20):
            bench.link.follow(known)
            await bench.clock.run_until(float(now))
            found[now] = bench.control.in_force
            if now == 300:
                bench.control.answer = RequestStatus(0, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
                cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
                await bench.clock.run_until(319.0)
                assert (await cycle).measurement is not None
    until = 200.0 + (measured_s or 0.0)
    for now, offsets in found.items():
        if when_stale == "hold" or now < until or now > 340:
            assert offsets == pytest.approx((0.0, 3.0, 7.0)), now
        elif until + 10 < now <= 300:
            assert offsets == pytest.approx((0.0, 3.0, 0.0)), now


async def test_a_write_that_does_not_take_effect_disarms_and_says_so_once() -> None:
    bench = LinkBench("compensate")
    bench.control.deaf = True
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert not bench.link.armed
    assert len([n for n in bench.notices if "disarmed" in n]) == 1
    nonzero = [offsets for _, offsets in bench.control.writes if any(offsets)]
    assert len(nonzero) == 1


async def test_after_a_lost_connection_it_begins_from_what_is_in_force() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.control.absent = True
        await bench.clock.run_until(20.0)
        bench.control.absent, bench.control.in_force = False, (0.0, 0.0, 0.0)  # it was switched off meanwhile
        first = len(bench.control.writes)
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(50.0)
    assert max(abs(v) for v in bench.control.writes[first][1]) <= 1.0
    assert bench.control.in_force == (0.0, 0.0, 4.0)
    assert len([n for n in bench.notices if "no answer" in n]) == 1


async def test_a_second_gateway_is_refused_and_the_message_says_so() -> None:
    bench = LinkBench("compensate")
    bench.control.owner = 99
    async with bench.following(4.0, until_s=10.0):
        assert bench.control.writes == []
        assert any("belongs to gateway 99" in notice for notice in bench.notices)
        bench.control.owner = 0
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(60.0)
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_gateway_that_lost_its_claim_while_running_stops_writing_at_once() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=2.5):
        bench.control.owner = 99
        before = len(bench.control.writes)
        await bench.clock.run_until(20.0)
    assert len(bench.control.writes) == before


async def test_without_a_watchdog_on_the_control_nothing_is_written() -> None:
    bench = LinkBench("compensate")
    bench.control.watching = False
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert bench.control.writes == []
    assert len(bench.control.beats) > 10
    [told] = bench.notices
    assert "watchdog does not answer the heartbeats: no offset is written" in told


async def test_a_watchdog_that_misses_the_first_beat_alone_is_not_reported() -> None:
    bench = LinkBench("compensate")
    bench.control.watching = False
    async with bench.running():
        await bench.clock.run_until(0.5)
        bench.control.watching = True
        await bench.clock.run_until(5.0)
        assert bench.notices == []
        bench.control.watching = False
        await bench.clock.run_until(8.0)
        bench.control.watching = True
        await bench.clock.run_until(10.0)
    assert [told.code for told in bench.notices] == [NoticeCode.NC_WATCHDOG_UNHEARD, NoticeCode.NC_WATCHDOG_HEARD]


async def test_a_control_slower_than_the_period_is_reported_once_until_it_is_quick_again() -> None:
    bench = LinkBench("monitor")
    quick, takes_s = bench.control.snapshot, 1.5

    async def slow() -> NcSnapshot:
        bench.clock.spend(takes_s)
        return await quick()

    bench.control.snapshot = slow  # type: ignore[method-assign]
    async with bench.running():
        await bench.clock.run_until(7.0)
        assert bench.notices == [], "it may be busy for a moment"
        await bench.clock.run_until(60.0)
        [told] = bench.notices
        assert "takes longer than [nc] period_s = 1" in told
        takes_s = 0.5
        await bench.clock.run_until(80.0)
    assert bench.notices[1:] == ["NC: cycles are within period_s again"]


async def test_after_the_watchdog_had_the_offsets_it_begins_from_where_they_are() -> None:
    bench = LinkBench("compensate")
    async with bench.following(8.0, until_s=15.0):
        bench.control.watching, bench.control.in_force = False, (0.0, 0.0, 2.0)  # ramped while this process hung
        await bench.clock.run_until(17.0)
        bench.control.watching = True
        first = len(bench.control.writes)
        await bench.clock.run_until(20.0)
    assert bench.control.writes[first][1][2] == pytest.approx(3.0)


@pytest.mark.parametrize(("told", "stands"), [("", False), ("as dry run", False), ("other feeds", True)])
async def test_a_control_whose_path_is_not_that_of_a_dry_run_is_asked_for_no_cycle(told: str, stands: bool) -> None:
    bench = LinkBench("compensate", paths=frozenset({"as dry run"}))
    bench.control.runs_dry, bench.control.path_mark = True, told
    async with bench.running():
        await bench.clock.run_until(0.5)
        assert (bench.link.barrier.code == NoticeCode.DRY_RUN_CHANGED) is stands
        measuring = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(2.5)
        measuring.cancel()
        await asyncio.gather(measuring, return_exceptions=True)
    assert bool(bench.control.requests) is not stands


@pytest.mark.parametrize(("shown", "requests"), [(None, 0), (True, 0), (False, 1)])
async def test_not_offered_is_believed_of_a_control_that_shows_it_now(shown: bool | None, requests: int) -> None:
    bench = LinkBench("compensate", dry_run="not offered", proven=False)
    bench.control.runs_dry = None  # at power on
    async with bench.running():
        await bench.clock.run_until(0.5)
        bench.control.runs_dry = shown
        await bench.clock.run_until(2.5)
        measuring = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(4.5)
        measuring.cancel()
        await asyncio.gather(measuring, return_exceptions=True)
    assert len(bench.control.requests) == requests


async def test_time_that_passes_after_an_unheard_beat_is_no_part_of_the_next_step() -> None:
    bench = LinkBench("compensate")
    now_s, slow_s = bench.clock.monotonic, 0.005

    def later() -> float:
        bench.clock.spend(slow_s)
        return now_s()

    async with bench.running():
        bench.link.follow(decision(8.0))
        bench.control.watching = False
        bench.clock.monotonic = later  # type: ignore[method-assign]
        await bench.clock.run_until(3.5)
        bench.control.watching, slow_s = True, 0.02
        await bench.clock.run_until(5.5)
    heights = [0.0, *(offsets[2] for _, offsets in bench.control.writes)]
    assert len(heights) > 2
    assert np.diff(heights).max() <= 1.0 + 1e-9, "1 µm/s, a period of 1 s"


@pytest.mark.parametrize("within", ["beat", "look", "read back"])
async def test_a_process_that_stood_still_since_its_beat_does_not_write(within: str) -> None:
    """watchdog_s = 10: after 6 s the control may be about to take the offsets away."""
    bench = LinkBench("compensate")
    async with bench.following(8.0, until_s=3.5):
        before = len(bench.control.writes)
        bench.control.hangs = within
        bench.control.looks = 0
        await bench.clock.run_until(40.0)
    sent = [offsets[2] for _, offsets in bench.control.writes[before + (within == "read back") :]]
    heights = [1.0, *sent]
    assert bench.link.armed
    assert np.abs(np.diff(heights)).max() <= 2.0  # the next write begins from where the watchdog was
    assert bench.control.in_force == (0.0, 0.0, 8.0)
    assert any("since the heartbeat" in notice for notice in bench.notices)


async def test_stopping_takes_the_offsets_back() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
    await bench.stopped(60.0)
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    told = [write.step.offsets_um for write in bench.steps if write.step.source is Source.STOPPED and write.written]
    assert told == [offsets for at, offsets in bench.control.writes if at > 10.0]
    assert told[-1] == (0.0, 0.0, 0.0)


async def test_a_write_without_an_answer_is_reported_as_one_that_may_have_acted() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=1.5):
        bench.control.swallows = True
        await bench.clock.run_until(2.5)
        bench.control.swallows = False
        await bench.clock.run_until(20.0)
    lost = [write for write in bench.steps if write.written and write.read_back_um is None]
    assert [write.step.offsets_um for write in lost] == [(0.0, 0.0, 2.0)]
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_step_like_the_one_before_is_stored_only_when_it_was_not_confirmed() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        stored, written = len(bench.steps), len(bench.control.writes)
        await bench.clock.run_until(15.0)
        assert len(bench.control.writes) == written + 5, "the same, each period"
        assert len(bench.steps) == stored
        bench.control.swallows = True
        await bench.clock.run_until(16.5)
    last = bench.steps[stored]
    assert (last.written, last.read_back_um, last.step.offsets_um) == (True, None, (0.0, 0.0, 4.0))


async def test_stopping_gives_the_control_back() -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        await bench.clock.run_until(3.0)
        assert bench.control.owner == 1
    await bench.stopped(10.0)
    assert bench.control.owner == 0


async def test_what_somebody_else_writes_disarms_instead_of_being_overwritten_by_a_step() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        bench.control.in_force = (0.0, 30.0, 4.0)
        before = len(bench.control.writes)
        bench.link.follow(decision(5.0))
        await bench.clock.run_until(20.0)
    assert len(bench.control.writes) == before
    assert not bench.link.armed
    assert len([notice for notice in bench.notices if "30.00" in notice and "disarmed" in notice]) == 1


@pytest.mark.parametrize(("again", "armed"), [(0, True), (1, False)])
@pytest.mark.parametrize("look", [1, 2])
async def test_one_spoilt_answer_disarms_nothing_and_two_do(look: int, again: int, armed: bool) -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        first = bench.control.looks + look
        bench.control.garbled = set(range(first, first + again + 1))
        bench.link.follow(decision(-4.0))
        await bench.clock.run_until(30.0)
    assert bench.link.armed is armed
    assert bench.control.in_force == (0.0, 0.0, -4.0) or not armed
    values = [offsets for _, offsets in bench.control.writes]
    assert all(abs(a - b) <= 1.0 for one, two in pairwise(values) for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize("spoilt", [{1}, {1, 2}, {2, 3}, {1, 4}])
async def test_no_ramp_begins_from_a_spoilt_answer(spoilt: set[int]) -> None:
    bench = LinkBench("compensate")
    bench.control.garbled = spoilt
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(30.0)
    values = [(0.0, 0.0, 0.0), *(offsets for _, offsets in bench.control.writes)]
    assert all(abs(a - b) <= 1.0 for one, two in pairwise(values) for a, b in zip(one, two, strict=True))
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_offsets_in_force_beyond_what_is_ever_sent_disarm_and_do_not_end_the_link() -> None:
    bench = LinkBench("compensate", in_force=(0.0, 0.0, 600.0))
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert bench.link.present is not None
        assert not bench.link.armed
        assert bench.link.present.monotonic_s >= 4.0, "reads go on"
    assert bench.control.writes == []
    assert not any(step.written for step in bench.steps)
    assert [notice for notice in bench.notices if "beyond largest_um" in notice and "disarmed" in notice]


async def test_a_read_back_that_is_not_a_number_agrees_with_nothing() -> None:
    bench = LinkBench("compensate")
    bench.control.spoils = True
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert not bench.link.armed
    assert len(bench.control.writes) == 1
    assert [notice for notice in bench.notices if "nan" in notice and "disarmed" in notice]


async def test_what_is_not_a_number_when_it_connects_is_reported_and_does_not_end_the_link() -> None:
    bench = LinkBench("compensate", in_force=(0.0, math.nan, 0.0))
    async with bench.following(4.0, until_s=10.0):
        assert bench.control.writes == []
        assert [notice for notice in bench.notices if "nan" in notice and "finite" in notice]
        bench.control.in_force = (0.0, 0.0, 0.0)
        await bench.clock.run_until(40.0)
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_stopped_in_the_middle_of_a_write_it_takes_the_offsets_back_and_reports_no_other_writer() -> None:
    bench = LinkBench("compensate")
    task = asyncio.create_task(bench.link.run())
    bench.link.follow(decision(8.0))
    await bench.clock.run_until(5.0)
    bench.control.late = asyncio.Event()
    await bench.clock.run_until(6.0)
    assert bench.control.in_write
    task.cancel()
    await bench.clock.run_until(6.1)
    bench.control.late.set()
    await asyncio.gather(task, return_exceptions=True)
    assert task.cancelled()
    await bench.stopped(60.0)
    assert bench.link.armed
    assert bench.notices == []
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert bench.control.owner == 0
    heights = [offsets[2] for _, offsets in bench.control.writes]
    assert np.abs(np.diff(heights)).max() <= 1.0 + 1e-9


async def test_a_step_that_cannot_be_stored_ends_the_link_and_the_offsets_are_still_taken_back() -> None:
    bench = LinkBench("compensate")
    task = asyncio.create_task(bench.link.run())
    bench.link.follow(decision(8.0))
    await bench.clock.run_until(5.0)
    bench.disk_full = True
    await bench.clock.run_until(7.0)
    with pytest.raises(OSError, match="no space left"):
        await task
    await bench.stopped(60.0)
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert bench.control.owner == 0
    assert bench.control.closed == 1


async def test_a_request_that_cannot_be_withdrawn_does_not_keep_the_offsets_from_being_taken_back() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        await bench.abandon_measurement(12.0)
    bench.control.busy = True
    await bench.stopped(60.0)
    assert bench.control.withdrawn == []
    assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert (bench.control.owner, bench.control.closed) == (0, 1)
