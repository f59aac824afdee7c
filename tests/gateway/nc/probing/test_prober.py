"""One probing cycle from the link's side: what stands still during it, and which results are accepted."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.nc import ProbingState, RequestStatus
from gateway.model.probing import End
from talc.frame import Why
from tests.benches.idle_loop import idle
from tests.benches.nc_link_bench import LinkBench, decision


async def test_offsets_stand_still_while_the_nc_probes_and_are_taken_out_of_the_result() -> None:
    bench = LinkBench("compensate")
    centres = ((1.0, 2.0, 3.0),) * 6
    async with bench.following(4.0, until_s=10.0):
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(12.0)
        written = len(bench.control.writes)
        bench.link.follow(decision(9.0))
        await bench.clock.run_until(30.0)
        assert len(bench.control.writes) == written
        bench.control.answer = RequestStatus(42, ProbingState.DONE, centres)
        await bench.clock.run_until(40.0)
        first = await cycle
        # The first cycle is the reference. The same centres again, with 5 µm more compensated in Z, mean that the
        # sphere has moved by those 5 µm.
        second = await bench.measured(60.0)
    assert first.in_force_um == (0.0, 0.0, 4.0)
    assert second.in_force_um == (0.0, 0.0, 9.0)
    assert first.measurement is not None
    assert second.measurement is not None
    np.testing.assert_allclose(first.measurement.errors, 0.0, atol=1e-9)
    moved = np.zeros(9)
    moved[1] = 5.0
    np.testing.assert_allclose(second.measurement.errors, moved, atol=1e-9)
    assert second.number == first.number + 1


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (RequestStatus(42, ProbingState.REFUSED, reason="alarm 21612"), "refused.*alarm 21612"),
        (RequestStatus(42, ProbingState.DONE, ((0.0, 0.0, math.nan),) * 6), "not a finite number"),
        (RequestStatus(42, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 5), "15 result values, expected 18"),
        (None, "did not end within 900 s"),
    ],
)
async def test_a_cycle_without_a_usable_result_says_why(answer: RequestStatus | None, reason: str) -> None:
    bench = LinkBench("compensate")
    bench.control.answer = answer
    async with bench.running():
        await bench.clock.run_until(2.0)
        outcome = await bench.measured(1000.0)
    assert outcome.measurement is None
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(outcome.reason)


async def test_a_chip_on_the_sphere_is_no_measurement() -> None:
    bench = LinkBench("compensate")
    good = np.zeros((6, 3))
    chip = good.copy()
    chip[2] += 0.08  # mm, in one pose only
    async with bench.running():
        await bench.clock.run_until(2.0)
        for centres in (good, chip):
            bench.control.answer = RequestStatus(0, ProbingState.DONE, tuple(map(tuple, centres)))
            outcome = await bench.measured(bench.clock.monotonic() + 5.0)
    assert outcome.measurement is None
    assert "is the sphere clean" in outcome.reason


def cycles(centres_um: list[float]) -> dict[int, RequestStatus]:
    """One cycle after another; in every pose the sphere is found displaced by this much in Z."""
    return {
        41 + n: RequestStatus(41 + n, ProbingState.DONE, ((0.0, 0.0, z * 1e-3),) * 6) for n, z in enumerate(centres_um)
    }


async def test_the_reference_is_the_mean_of_its_cycles() -> None:
    bench = LinkBench("compensate")
    bench.control.answers = cycles([3.0, -1.0, 0.0, 2.0, 1.0, 8.0])
    async with bench.running():
        await bench.clock.run_until(2.0)
        reference = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
        later = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(40.0)
    assert bench.control.requests == [41, 42, 43, 44, 45, 46]
    first, second = (await reference).measurement, (await later).measurement
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first.errors, 0.0, atol=1e-9)
    assert second.errors[1] == pytest.approx(7.0)  # 8 against the mean of the five, 1


async def test_a_reference_is_refused_while_the_machine_moves() -> None:
    bench = LinkBench("compensate")
    bench.control.answers = cycles([0.0, 6.0, 12.0, 18.0, 24.0])
    async with bench.running():
        await bench.clock.run_until(2.0)
        reference = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
    outcome = await reference
    assert outcome.measurement is None
    assert "differ by 24.0 µm" in outcome.reason
    assert "at rest" in outcome.reason


async def test_a_cycle_whose_touches_do_not_repeat_is_no_measurement() -> None:
    bench = LinkBench("compensate")
    bench.control.answer = RequestStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6, spread_mm=0.030)
    async with bench.running():
        await bench.clock.run_until(2.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
    outcome = await cycle
    assert outcome.measurement is None
    assert outcome.end is End.REJECTED
    assert "repeated touches of a point differ by 30.0 µm" in outcome.reason


async def test_a_result_that_the_prediction_does_not_know_must_be_found_twice() -> None:
    bench = LinkBench("compensate")
    bench.control.answers = cycles([0.0] * 5 + [20.0, 20.5, 90.0])
    sure = replace(decision(0.0), sigma=np.ones(9), limits=np.full(9, 3.0))
    outcomes = []
    async with bench.running():
        for _ in range(4):
            bench.link.follow(sure)
            outcomes.append(await bench.measured(bench.clock.monotonic() + 20.0))
    assert [o.end for o in outcomes] == [End.MEASURED, End.REJECTED, End.MEASURED, End.REJECTED]
    assert "a second cycle must give the same result" in outcomes[1].reason
    assert "more than is possible" in outcomes[3].reason
    assert outcomes[3].centres_mm is not None  # what was rejected is there to be looked at


async def test_a_write_under_way_ends_before_the_offsets_stand_still() -> None:
    bench = LinkBench("compensate")
    bench.control.answer = RequestStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
    async with bench.following(20.0, until_s=5.0):
        bench.control.slow = asyncio.Event()
        await bench.clock.run_until(6.0)
        assert bench.control.in_write
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await idle()
        meanwhile = list(bench.control.requests)
        bench.control.slow.set()
        await idle()
        standing = bench.control.in_force
        await bench.clock.run_until(30.0)
        assert (await cycle).in_force_um == standing
    assert meanwhile == []


async def test_stopping_withdraws_the_request_that_nobody_waits_for() -> None:
    bench = LinkBench("monitor")
    async with bench.running():
        await bench.clock.run_until(3.0)
        await bench.abandon_measurement(6.0)
    await bench.link.stop()
    assert bench.control.withdrawn == bench.control.requests == [41]


async def test_stopping_withdraws_a_request_before_the_offsets_move() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=10.0):
        await bench.abandon_measurement(12.0)
    written, withdraw = len(bench.control.writes), bench.control.withdraw_probing
    before_it: list[int] = []

    async def withdrawn(number: int) -> None:
        before_it.append(len(bench.control.writes) - written)
        await withdraw(number)

    bench.control.withdraw_probing = withdrawn  # type: ignore[method-assign]
    await bench.stopped(30.0)
    assert before_it == [0]
    assert len(bench.control.writes) - written == 4, "the ramp to zero"


async def test_what_has_ended_is_not_withdrawn() -> None:
    bench = LinkBench("monitor")
    bench.control.answer = RequestStatus(41, ProbingState.REFUSED, reason="alarm")
    async with bench.running():
        await bench.clock.run_until(3.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(6.0)
        await cycle
    await bench.link.stop()
    assert bench.control.withdrawn == []


async def test_a_request_that_the_control_does_not_take_is_refused_and_not_withdrawn() -> None:
    bench = LinkBench("monitor")
    bench.control.busy = True
    async with bench.running():
        await bench.clock.run_until(3.0)
        outcome = await bench.measured(6.0)
    assert outcome.end is End.REFUSED
    assert "did not take the request: device nc: another cycle is under way" in outcome.reason
    await bench.link.stop()
    assert bench.control.withdrawn == []


async def test_offsets_that_moved_while_the_control_probed_make_no_measurement() -> None:
    bench = LinkBench("compensate")
    async with bench.following(20.0, until_s=30.0):
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(32.0)
        bench.control.watching, bench.control.in_force = False, (0.0, 0.0, 8.0)  # ramped while this process hung
        await bench.clock.run_until(34.0)
        bench.control.watching = True
        bench.control.answer = RequestStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.012),) * 6)
        await bench.clock.run_until(45.0)
        moved = await cycle
        reference = await bench.measured(60.0, Why.RETRY)
    assert (moved.measurement, moved.end) == (None, End.REJECTED)
    assert "the offsets moved while the control probed: 0.00 0.00 20.00 µm were in force" in moved.reason
    assert reference.measurement is not None, "what was rejected is no reference either"


@pytest.mark.parametrize("when_stale", ["zero", "hold"])
async def test_disarmed_nothing_is_measured_while_the_watchdog_takes_the_offsets_to_zero(when_stale: str) -> None:
    bench = LinkBench("compensate", when_stale=when_stale)
    bench.control.answer = RequestStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
    ends, asked = [], []
    async with bench.following(4.0, until_s=10.0):
        for in_force in ((0.0, 30.0, 4.0), (0.0, 0.0, 0.0)):
            bench.control.in_force = in_force  # first by somebody else's hand, then the watchdog has done its work
            await bench.clock.run_until(bench.clock.monotonic() + 5.0)
            assert not bench.link.armed
            outcome = await bench.measured(bench.clock.monotonic() + 15.0)
            ends.append(outcome.end)
            asked.append(len(bench.control.requests))
            assert outcome.end is End.MEASURED or "its offsets are still ramping to zero" in outcome.reason
    if when_stale == "zero":
        assert ends == [End.REFUSED, End.MEASURED]
        assert asked[0] == 0
    else:  # what the watchdog holds stands still
        assert ends == [End.MEASURED, End.MEASURED]


async def test_stopped_while_the_control_is_asked_for_the_result_the_request_is_still_withdrawn() -> None:
    bench = LinkBench("monitor")
    async with bench.running():
        await bench.clock.run_until(3.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(3.5)
        bench.control.late = asyncio.Event()
        await bench.clock.run_until(5.0)
        assert bench.control.in_write
        cycle.cancel()
        await bench.clock.run_until(5.1)
        bench.control.late.set()
        await asyncio.gather(cycle, return_exceptions=True)
        assert cycle.cancelled()
    await bench.link.stop()
    assert bench.control.withdrawn == bench.control.requests == [41]


@pytest.mark.parametrize("armed", [True, False])
async def test_the_request_of_an_earlier_run_is_withdrawn_once_where_probing_is_armed(armed: bool) -> None:
    bench = LinkBench("monitor", armed=armed, abandoned=40)
    async with bench.running():
        await bench.clock.run_until(5.0)
    await bench.link.stop()
    assert bench.control.withdrawn == ([40] if armed else [])


async def test_a_request_that_cannot_be_withdrawn_does_not_stop_the_compensation() -> None:
    bench = LinkBench("compensate", abandoned=40)
    bench.control.busy = True
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert bench.control.in_force == (0.0, 0.0, 4.0)
    assert bench.notices == []


async def test_a_cycle_that_does_not_end_in_its_time_is_withdrawn_at_once() -> None:
    bench = LinkBench("monitor")
    async with bench.running():
        await bench.clock.run_until(2.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(900.0)
        assert bench.control.withdrawn == []
        await bench.clock.run_until(910.0)
        assert bench.control.withdrawn == bench.control.requests == [41]
        assert (await cycle).end is End.REJECTED


@pytest.mark.slow
async def test_without_a_prediction_a_measurement_of_the_last_hour_stands_in_and_an_older_one_does_not() -> None:
    bench = LinkBench("monitor")
    bench.control.answers = cycles([0.0] * 5 + [90.0] * 3)
    outcomes = []
    async with bench.running():
        for at in (2.0, 3500.0, 3700.0):
            await bench.clock.run_until(at)
            outcomes.append(await bench.measured(at + 20.0))
    assert [o.end for o in outcomes] == [End.MEASURED, End.REJECTED, End.MEASURED]
    assert "more than is possible" in outcomes[1].reason
