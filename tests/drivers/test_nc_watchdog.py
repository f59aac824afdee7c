"""Claim, heartbeat and the control's own watchdog, over the real wire to the emulated control."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from drivers.base import Refused
from drivers.nc import WatchdogTerms
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from simulators.nc.watchdog import R_BEAT, R_ECHO, R_OWNER, R_RAMP, R_SILENCE, R_WATCH
from tests.benches.emulated_bench import OpcUaBench, sinumerik_bench

pytestmark = pytest.mark.simulated_time

WATCH = WatchdogTerms(silence_s=5.0, ramp_um_per_s=1.0)


@asynccontextmanager
async def second(bench: OpcUaBench) -> AsyncIterator[Sinumerik]:
    other = Sinumerik(SinumerikSettings(security="none", url=bench.url), bench.clock)
    await other.connect()
    try:
        yield other
    finally:
        await other.close()


def not_installed(now_s: float) -> None:
    """TALC_START never ran on this control."""


async def beat_at(bench: OpcUaBench, *times: float) -> list[bool]:
    found = []
    for now in times:
        bench.clock.move_to(now)
        found.append(await bench.nc.heartbeat(7))
    return found


async def test_after_silence_the_offsets_go_to_zero_at_the_declared_rate() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0, 5.0, 9.5) == [True, True, True]
        await bench.nc.write_compensation((8.0, -3.0, 0.5))
        bench.clock.move_to(14.4)
        assert await bench.nc.read_compensation() == pytest.approx((8.0, -3.0, 0.5))
        bench.clock.move_to(16.5)
        assert await bench.nc.read_compensation() == pytest.approx((6.0, -1.0, 0.0))
        bench.clock.move_to(60.0)
        assert await bench.nc.read_compensation() == pytest.approx((0.0, 0.0, 0.0))


async def test_a_beat_before_which_another_one_did_not_pass_does_not_count() -> None:
    """Part of the program was missing, or somebody else wrote it: what is in force has to be read again."""
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0, 2.0) == [True, True]
        bench.control.nck.r[R_BEAT] += 5.0
        assert await beat_at(bench, 3.0, 4.0) == [False, True]


async def test_after_silence_the_offsets_are_held_where_that_is_declared() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WatchdogTerms(5.0, 0.0))
        await bench.nc.write_compensation((8.0, -3.0, 0.5))
        bench.clock.move_to(600.0)
        assert await bench.nc.read_compensation() == pytest.approx((8.0, -3.0, 0.5))
        assert await bench.nc.heartbeat(7) is False


async def test_a_heartbeat_stops_the_ramp_and_reports_that_it_had_begun() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        await bench.nc.write_compensation((8.0, 0.0, 0.0))
        assert await beat_at(bench, 7.0, 8.0) == [False, True]
        assert await bench.nc.read_compensation() == pytest.approx((6.0, 0.0, 0.0))


@pytest.mark.parametrize(("number", "value"), [(R_SILENCE, 99999.0), (R_RAMP, 0.0)])
async def test_a_watchdog_with_other_terms_than_the_claim_s_does_not_count(number: int, value: float) -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0, 2.0) == [True, True]
        bench.control.nck.r[number] = value  # a part program uses it
        assert await beat_at(bench, 3.0, 4.0) == [False, False]
        await bench.nc.claim(7, WATCH)
        assert (await beat_at(bench, 5.0, 6.0))[-1] is True


async def test_a_second_gateway_is_refused_until_the_first_is_silent_or_gone() -> None:
    async with sinumerik_bench() as bench, second(bench) as other:
        await bench.nc.claim(7, WATCH)
        with pytest.raises(Refused, match="belongs to gateway 7"):
            await other.claim(8, WATCH)
        with pytest.raises(Refused, match="belongs to gateway 7"):
            await other.heartbeat(8)
        await other.release(8)  # not its own: nothing happens
        assert await beat_at(bench, 1.0) == [True]
        bench.clock.move_to(20.0)
        await other.claim(8, WATCH)
        with pytest.raises(Refused, match="belongs to gateway 8"):
            await bench.nc.heartbeat(7)
        await other.release(8)
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 21.0) == [True]


async def test_the_control_has_the_terms_before_the_owner_and_the_owner_before_the_beat() -> None:
    """A gateway that is killed between two of these writes leaves no owner whose terms are another's."""
    async with sinumerik_bench() as bench:
        nck = bench.control.nck
        await bench.nc.claim(6, WatchdogTerms(silence_s=600.0, ramp_um_per_s=0.0))
        await bench.nc.release(6)
        after_each_write: list[tuple[float, ...]] = []
        wake = bench.control.wake

        def noted() -> None:
            after_each_write.append(tuple(nck.r[n] for n in (R_SILENCE, R_RAMP, R_OWNER, R_BEAT)))
            wake()

        bench.control.wake = noted  # type: ignore[method-assign]
        await bench.nc.claim(7, WATCH)
        assert after_each_write == [(5.0, 1e-3, 0.0, 1.0), (5.0, 1e-3, 7.0, 1.0), (5.0, 1e-3, 7.0, 2.0)]


async def test_the_same_gateway_may_claim_again_after_it_was_killed() -> None:
    async with sinumerik_bench() as bench, second(bench) as restarted:
        await bench.nc.claim(7, WATCH)
        await restarted.claim(7, WATCH)
        assert await restarted.heartbeat(7)


async def test_giving_back_takes_what_is_left_to_zero() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        await bench.nc.write_compensation((2.0, 0.0, 0.0))
        await bench.nc.release(7)
        assert await bench.nc.read_compensation() == pytest.approx((2.0, 0.0, 0.0))
        bench.clock.move_to(1.0)
        assert await bench.nc.read_compensation() == pytest.approx((1.0, 0.0, 0.0))


async def test_silence_counts_from_when_the_gateway_leaves_not_from_the_next_look() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        await bench.nc.write_compensation((3.0, 0.0, 0.0))
        bench.clock.move_to(0.5)
        await bench.nc.release(7)
        bench.clock.move_to(2.5)
        assert await bench.nc.read_compensation() == pytest.approx((1.0, 0.0, 0.0))


async def test_power_off_and_on_leaves_no_offset_and_no_owner() -> None:
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        await bench.nc.write_compensation((2.0, 3.0, 4.0))
        bench.control.nck.power_on(bench.clock.now)
        assert await bench.nc.read_compensation() == (0.0, 0.0, 0.0)
        with pytest.raises(Refused, match="gateway 0"):
            await bench.nc.heartbeat(7)
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0) == [True]


async def test_a_control_without_the_watchdog_is_never_alive() -> None:
    async with sinumerik_bench() as bench:
        bench.control.nck.watchdog.beat = not_installed  # type: ignore[method-assign]
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0, 2.0, 3.0) == [False, False, False]


@pytest.mark.parametrize("echo", [0.0, 1.0, 2.0, 3.0])
async def test_what_the_control_keeps_without_power_is_no_sign_of_a_watchdog(echo: float) -> None:
    """Whatever R94 and R68 were, and although R96 still says that it is alive."""
    async with sinumerik_bench() as bench:
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 1.0) == [True]
        nck = bench.control.nck
        nck.power_on(2.0, started=False)
        assert nck.r[R_WATCH] == 1.0
        nck.r[R_ECHO] = nck.r[R_BEAT] - 2.0 + echo
        assert await beat_at(bench, 3.0, 4.0, 5.0) == [False, False, False]
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 6.0, 7.0) == [False, False]
        nck.power_on(8.0)
        await bench.nc.claim(7, WATCH)
        assert await beat_at(bench, 9.0) == [True]


@pytest.mark.parametrize(("silence_s", "ramp"), [(0.0, 1.0), (float("nan"), 1.0), (1.0, -1.0), (1.0, float("inf"))])
def test_an_impossible_watch_is_refused(silence_s: float, ramp: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        WatchdogTerms(silence_s, ramp)
