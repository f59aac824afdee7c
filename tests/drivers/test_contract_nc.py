"""What every numerical control must do, whatever its kind and protocol; nc_benches lists them."""

import asyncio
import itertools
import math
from collections.abc import AsyncIterator, Callable
from datetime import UTC, timedelta
from pathlib import Path

import pytest

from drivers.base import DriverError, Quality, Refused
from drivers.nc import NcSnapshot, OperatingMode, ProbingState, RunsDry, WatchdogTerms
from tests.benches.nc_benches import BENCHES, SLOW, NcBench

WATCH = WatchdogTerms(silence_s=60.0, ramp_um_per_s=2.0)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "bench" in metafunc.fixturenames:
        marks = {name: [pytest.mark.simulated_time] + [pytest.mark.slow] * (name in SLOW) for name in BENCHES}
        metafunc.parametrize("bench", [pytest.param(name, marks=marks[name]) for name in BENCHES], indirect=True)


@pytest.fixture
async def bench(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[NcBench]:
    async with BENCHES[request.param](tmp_path) as opened:
        yield opened


async def shows(bench: NcBench, wanted: Callable[[NcSnapshot], bool]) -> None:
    """Wait for the snapshot: a control that reports changes does so a moment later, in the computer's time."""
    async with asyncio.timeout(60.0):
        while not wanted(await bench.nc.snapshot()):
            await asyncio.sleep(0.02)


async def test_the_snapshot_holds_time_quality_axes_speeds_tool_and_alarms(bench: NcBench) -> None:
    await bench.work()
    await shows(bench, lambda snapshot: snapshot.states.get("spindle_speed") == bench.working["spindle_speed"])
    first = await bench.nc.snapshot()
    await bench.wait(bench.tick_s)
    second = await bench.nc.snapshot()
    assert set(first.positions) == {"X", "Y", "Z", "A", "C"}
    assert all(math.isfinite(value) for value in first.positions.values())
    assert {"spindle_speed", "coolant", *(f"speed_{axis}" for axis in "XYZAC")} <= set(first.states)
    for name, value in bench.working.items():
        assert first.states[name] == pytest.approx(value), name
    assert first.mode is not OperatingMode.UNKNOWN
    assert first.tool
    assert first.probe_in_spindle is False
    assert first.alarms == ()
    assert first.quality is Quality.GOOD
    assert first.time.tzinfo is UTC
    assert first.monotonic_s < second.monotonic_s
    passed = timedelta(seconds=second.monotonic_s - first.monotonic_s)
    assert abs((second.time - first.time) - passed) < timedelta(seconds=0.2)


async def test_an_emergency_stop_is_an_alarm_until_it_is_over(bench: NcBench) -> None:
    await bench.stop()
    await shows(bench, lambda snapshot: snapshot.alarms != ())
    await bench.switch_on()
    await shows(bench, lambda snapshot: snapshot.alarms == ())


async def test_a_cycle_goes_from_the_request_to_its_result_and_its_number_is_used_up(bench: NcBench) -> None:
    assert (await bench.nc.probing_status(3)).state is ProbingState.IDLE
    await bench.nc.request_probing(4)
    asked = await bench.nc.probing_status(4)
    assert asked.state in (ProbingState.REQUESTED, ProbingState.ACCEPTED)
    assert asked.centres_mm is None
    await bench.allow_probing()
    running = await bench.reaches(4, ProbingState.RUNNING)
    assert running.centres_mm is None
    done = await bench.ends(4)
    assert done.state is ProbingState.DONE
    assert done.centres_mm is not None
    assert len(done.centres_mm) == 6
    # The sphere of a machine without errors: radius 120 mm, 80 mm above A.
    for (x, y, z), expected in zip(done.centres_mm[:2], ((120.0, 0.0, 80.0), (0.0, 120.0, 80.0)), strict=True):
        assert (x, y, z) == pytest.approx(expected, abs=0.01)
    assert await bench.nc.probing_status(4) == done
    assert (await bench.nc.probing_status(3)).state is ProbingState.IDLE
    assert (await bench.nc.probing_status(5)).state is ProbingState.IDLE
    with pytest.raises(Refused, match="number 4"):
        await bench.nc.request_probing(4)


async def test_a_dry_run_goes_over_the_sphere(bench: NcBench) -> None:
    assert isinstance(bench.nc, RunsDry)
    assert bench.nc.runs_dry
    for impossible in (-1.0, math.nan, 1000.5):
        with pytest.raises(ValueError, match="dry_run_mm"):
            await bench.nc.request_probing(4, impossible)
    await bench.nc.request_probing(4, 50.0)
    await bench.allow_probing()
    await bench.reaches(4, ProbingState.RUNNING)
    done = await bench.ends(4)
    assert done.state is ProbingState.DONE
    assert done.centres_mm is not None
    assert len(done.centres_mm) == 6
    for (_, _, z), height in zip(done.centres_mm, (80.0, 80.0, 80.0, 80.0, 0.0, 0.0), strict=True):
        assert z > height + 49.0  # over the sphere at each pose
    await bench.nc.request_probing(5)  # and the next one touches again
    touched = await bench.ends(5)
    assert touched.centres_mm is not None
    assert touched.centres_mm[0] == pytest.approx((120.0, 0.0, 80.0), abs=0.01)


async def test_a_withdrawn_request_ends_and_leaves_room_for_the_next(bench: NcBench) -> None:
    await bench.nc.request_probing(1)
    await bench.nc.withdraw_probing(1)
    ended = await bench.ends(1)
    assert (ended.state, ended.reason) == (ProbingState.REFUSED, "withdrawn")
    await bench.allow_probing()
    await bench.nc.request_probing(2)
    await bench.reaches(2, ProbingState.RUNNING)
    await bench.nc.withdraw_probing(7)  # another number changes nothing
    assert (await bench.nc.probing_status(2)).state is ProbingState.RUNNING
    await bench.nc.withdraw_probing(2)
    stopped = await bench.ends(2)
    assert (stopped.state, stopped.reason, stopped.centres_mm) == (ProbingState.FAILED, "withdrawn", None)


async def test_a_request_that_waits_or_runs_is_not_displaced_and_the_snapshot_shows_that_it_runs(
    bench: NcBench,
) -> None:
    await bench.nc.request_probing(1)
    with pytest.raises(Refused, match="1"):
        await bench.nc.request_probing(2)
    assert (await bench.nc.probing_status(2)).state is ProbingState.IDLE
    assert (await bench.nc.snapshot()).probing is False
    await bench.allow_probing()
    await bench.reaches(1, ProbingState.RUNNING)
    await shows(bench, lambda snapshot: snapshot.probing is True)
    with pytest.raises(Refused, match="1"):
        await bench.nc.request_probing(2)
    assert (await bench.ends(1)).state is ProbingState.DONE
    await shows(bench, lambda snapshot: snapshot.probing is False)
    await bench.nc.request_probing(2)
    assert (await bench.nc.probing_status(2)).state in (ProbingState.REQUESTED, ProbingState.ACCEPTED)


async def test_an_emergency_stop_ends_the_cycle_and_the_next_request_is_refused(bench: NcBench) -> None:
    await bench.allow_probing()
    await bench.nc.request_probing(1)
    await bench.reaches(1, ProbingState.RUNNING)
    await bench.stop()
    failed = await bench.ends(1)
    assert failed.state is ProbingState.FAILED
    assert failed.reason
    assert failed.centres_mm is None
    await bench.nc.request_probing(2)
    refused = await bench.ends(2)
    assert refused.state is ProbingState.REFUSED
    assert refused.reason


async def test_offsets_are_read_back_and_invalid_ones_are_never_sent(bench: NcBench) -> None:
    await bench.alive(7, WATCH)
    await bench.nc.write_compensation((12.5, -7.25, 3.0))

    async def written() -> bool:  # at once, or at the slew of a control that keeps one
        return await bench.nc.read_compensation() == pytest.approx((12.5, -7.25, 3.0), abs=2e-3)

    await bench.until(written)
    for bad, axis in itertools.product((math.nan, math.inf, -math.inf, 501.0), range(3)):
        offsets = [4.0, 5.0, 6.0]
        offsets[axis] = bad
        with pytest.raises(ValueError, match="nothing was sent"):
            await bench.nc.write_compensation((offsets[0], offsets[1], offsets[2]))
    assert await bench.nc.read_compensation() == pytest.approx((12.5, -7.25, 3.0), abs=2e-3)


async def test_one_gateway_at_a_time_and_what_it_leaves_goes_to_zero(bench: NcBench) -> None:
    await bench.alive(7, WatchdogTerms(silence_s=60.0, ramp_um_per_s=20.0))
    await bench.nc.write_compensation((2.0, 0.0, -1.0))
    with pytest.raises(Refused):
        await bench.nc.heartbeat(8)
    await bench.nc.release(8)  # not its own: nothing happens
    assert await bench.nc.heartbeat(7) is True
    for predecessor in (None, 9):
        with pytest.raises(Refused):
            await bench.nc.claim(8, WATCH, predecessor)
    await bench.nc.release(7)

    async def gone() -> bool:
        return await bench.nc.read_compensation() == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)

    await bench.until(gone)
    await bench.alive(8, WATCH)


async def test_a_run_takes_over_from_the_one_before_it_while_that_still_counts_as_alive(bench: NcBench) -> None:
    await bench.alive(7, WatchdogTerms(silence_s=60.0, ramp_um_per_s=20.0))
    await bench.nc.claim(8, WATCH, 7)
    await bench.until(lambda: bench.nc.heartbeat(8))
    with pytest.raises(Refused):
        await bench.nc.heartbeat(7)
    with pytest.raises(Refused):
        await bench.nc.claim(7, WATCH, 6)


async def test_silence_is_noticed_and_the_next_heartbeat_reports_it(bench: NcBench) -> None:
    await bench.alive(7, WATCH)
    await bench.nc.write_compensation((20.0, 0.0, 0.0))

    async def written() -> bool:
        return (await bench.nc.read_compensation())[0] == pytest.approx(20.0, abs=2e-3)

    async def ramping() -> bool:
        return (await bench.nc.read_compensation())[0] < 19.0

    await bench.until(written)
    assert await bench.nc.heartbeat(7) is True
    await bench.nc.claim(7, WatchdogTerms(silence_s=40 * bench.tick_s, ramp_um_per_s=20.0))
    await bench.until(ramping)
    assert await bench.nc.heartbeat(7) is False


async def test_impossible_numbers(bench: NcBench) -> None:
    for number in (0, -1, 2**31):
        for verb in (bench.nc.request_probing, bench.nc.probing_status, bench.nc.withdraw_probing, bench.nc.heartbeat):
            with pytest.raises(ValueError, match=f"= {number}: expected 1 to"):
                await verb(number)
        with pytest.raises(ValueError, match=f"owner = {number}"):
            await bench.nc.claim(number, WATCH)


async def test_without_a_connection_every_verb_says_so_and_closing_is_harmless(bench: NcBench) -> None:
    other = bench.another()
    await other.close()
    for call in (
        other.snapshot, lambda: other.request_probing(1), lambda: other.probing_status(1),
        lambda: other.withdraw_probing(1), lambda: other.write_compensation((0.0, 0.0, 0.0)),
        other.read_compensation, lambda: other.claim(1, WATCH), lambda: other.heartbeat(1),
    ):  # fmt: skip
        with pytest.raises(DriverError, match="connect first"):
            await call()
    await bench.nc.close()
    await bench.nc.close()
    with pytest.raises(DriverError, match="connect first"):
        await bench.nc.snapshot()
    await bench.nc.connect()
    assert (await bench.nc.snapshot()).quality is Quality.GOOD
