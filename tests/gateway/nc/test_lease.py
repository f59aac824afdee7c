"""The right to write: when it is claimed, confirmed, reported, lost and given up."""

import logging
from typing import Any, cast

import pytest

from drivers.base import NoAnswer
from drivers.nc import NumericalControl, WatchdogTerms
from gateway.config.sections import Compensation
from gateway.model.notice import Notice
from gateway.model.text import plain
from gateway.nc.lease import Lease
from gateway.nc.settings import Identity
from gateway.nc.states import Right
from gateway.runtime.problems import Problems
from tests.benches.stepped_clock import SteppedClock

SILENT, EAR = "NC: its watchdog does not answer the heartbeats", "NC: its watchdog did not receive the heartbeat"
AGAIN = "NC: its watchdog is active again"


class Claimed:
    """The part of a control that a lease needs; notes the requests."""

    def __init__(self, clock: SteppedClock) -> None:
        self.clock, self.asked, self.heard, self.takes_s = clock, list[tuple[object, ...]](), True, 0.0

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        self.asked.append(("claim", owner, terms, predecessor))

    async def heartbeat(self, owner: int) -> bool:
        self.asked.append(("heartbeat", owner))
        self.clock.spend(self.takes_s)
        return self.heard

    async def release(self, owner: int) -> None:
        self.asked.append(("release", owner))


class LeaseBench:
    """A lease, its control and what it reported."""

    def __init__(self, **settings: Any) -> None:
        self.clock = SteppedClock()
        self.control, self.notices = Claimed(self.clock), list[Notice]()
        given = {"mode": "compensate", "watchdog_s": 4.0, "slew_um_per_s": 2.0} | settings
        self.lease = Lease(
            cast("NumericalControl", self.control),
            self.clock,
            Identity(7, 6),
            Compensation(**given),
            Problems(self.clock, 1.0, self.notices.append, logging.getLogger(__name__)),
            self.notices.append,
        )

    async def beats(self, *heard: bool) -> list[str]:
        """What is reported during a series of heartbeats after the claim."""
        await self.lease.claim()
        for each in heard:
            self.control.heard = each
            assert await self.lease.beat() is each
        return [notice.text for notice in self.notices]


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_in_a_mode_that_writes_nothing_it_asks_the_control_for_nothing(mode: str) -> None:
    bench = LeaseBench(mode=mode)
    await bench.lease.claim()
    bench.lease.lost()
    await bench.lease.release()
    assert bench.control.asked == []
    assert bench.lease.right is Right.NONE
    assert not bench.lease.armed
    assert not bench.lease.taken_back


async def test_it_claims_beats_and_releases_under_its_own_number() -> None:
    bench = LeaseBench()
    assert (bench.lease.right, bench.lease.armed) == (Right.UNCLAIMED, True)
    await bench.lease.claim()
    assert bench.lease.right is Right.UNHEARD
    await bench.lease.beat()
    assert (bench.lease.right, bench.lease.armed) == (Right.HEARD, True)
    await bench.lease.release()
    terms = WatchdogTerms(4.0, 2.0, 2.0)
    assert bench.control.asked == [("claim", 7, terms, 6), ("heartbeat", 7), ("release", 7)]
    assert bench.notices == []


async def test_unheard_it_may_not_write_until_it_is_heard() -> None:
    bench = LeaseBench()
    await bench.lease.claim()
    found = []
    for heard in (False, True, False):
        bench.control.heard = heard
        await bench.lease.beat()
        found.append(bench.lease.right)
    assert found == [Right.UNHEARD, Right.HEARD, Right.UNHEARD]


@pytest.mark.parametrize(("when_stale", "ramp", "taken"), [("zero", 2.0, True), ("hold", 0.0, False)])
async def test_the_control_is_told_what_is_declared_and_disarmed_it_does_that(
    when_stale: str, ramp: float, taken: bool
) -> None:
    bench = LeaseBench(when_stale=when_stale)
    await bench.lease.claim()
    assert bench.control.asked == [("claim", 7, WatchdogTerms(4.0, ramp, 2.0), 6)]
    assert not bench.lease.taken_back
    bench.lease.disarm(plain("another program wrote"))
    assert bench.lease.taken_back is taken
    assert (bench.lease.right, bench.lease.armed) == (Right.DISARMED, False)
    assert bench.notices == [Notice("offsets of NC", plain("another program wrote"))]
    bench.lease.lost()
    await bench.lease.claim()
    await bench.lease.release()
    assert len(bench.control.asked) == 1
    assert bench.lease.right is Right.DISARMED


async def test_one_beat_that_is_not_heard_at_the_beginning_is_not_reported_and_two_are() -> None:
    assert await LeaseBench().beats(False, True, True) == []
    texts = await LeaseBench().beats(False, False, False, False)
    assert len(texts) == 1
    assert texts[0].startswith(SILENT)
    assert texts[0].endswith("Has its program been started since power-on?")


async def test_a_watchdog_that_was_active_and_is_not_is_reported_once_and_so_is_its_return() -> None:
    bench = LeaseBench()
    texts = await bench.beats(True, True, False, False, False, True, True, False)
    assert [text.partition(" of this")[0] for text in texts] == [EAR, AGAIN, EAR]
    assert [notice.ended for notice in bench.notices] == [False, True, False]
    assert {notice.subject for notice in bench.notices} == {"watchdog of NC"}


async def test_the_end_of_a_silence_that_was_reported_at_the_beginning_is_reported_too() -> None:
    texts = await LeaseBench().beats(False, False, True, True, True)
    assert texts[1:] == [AGAIN]
    assert texts[0].startswith(SILENT)


@pytest.mark.parametrize(("passed_s", "heard"), [(3.4, True), (3.6, False)])
async def test_a_silence_within_a_beat_counts_though_the_control_was_found_active(passed_s: float, heard: bool) -> None:
    bench = LeaseBench()
    await bench.lease.claim()
    bench.control.takes_s = 0.5
    assert await bench.lease.beat()
    bench.clock.spend(passed_s - 0.5)
    assert await bench.lease.beat() is heard, "4 s after the beat before, the control may have begun to ramp"
    assert await bench.lease.beat()


async def test_a_beat_is_fresh_for_half_of_the_silence_from_when_it_was_sent() -> None:
    bench = LeaseBench()
    with pytest.raises(NoAnswer, match="more than 2 s since the heartbeat"):
        bench.lease.check_fresh()
    await bench.lease.claim()
    bench.control.takes_s = 0.5
    await bench.lease.beat()
    bench.clock.spend(1.5)
    bench.lease.check_fresh()
    bench.clock.spend(0.01)
    with pytest.raises(NoAnswer, match="more than 2 s since the heartbeat") as told:
        bench.lease.check_fresh()
    assert told.value.device == "nc"
    bench.control.takes_s = 0.0
    await bench.lease.beat()
    bench.lease.check_fresh()


async def test_a_lost_connection_leaves_the_claim_to_be_made_again() -> None:
    bench = LeaseBench()
    await bench.beats(True)
    bench.lease.lost()
    assert (bench.lease.right, bench.lease.armed) == (Right.UNCLAIMED, True)
    await bench.lease.claim()
    assert [call[0] for call in bench.control.asked] == ["claim", "heartbeat", "claim"]


async def test_what_happened_to_a_write_is_reported_and_it_goes_on() -> None:
    bench = LeaseBench()
    await bench.beats(True)
    bench.lease.tell(plain("a write arrived late"))
    assert bench.notices == [Notice("late write to NC", plain("a write arrived late"))]
    assert bench.lease.right is Right.HEARD


async def test_a_slow_ramp_takes_the_offsets_back_too_and_only_once_it_is_disarmed() -> None:
    bench = LeaseBench(slew_um_per_s=0.5)
    assert await bench.beats(True) == []
    assert not bench.lease.taken_back
    bench.lease.disarm(plain("another program wrote"))
    assert bench.lease.taken_back


async def test_half_of_an_odd_silence_is_not_rounded() -> None:
    bench = LeaseBench(watchdog_s=9.0)
    await bench.beats(True)
    bench.clock.spend(4.4)
    bench.lease.check_fresh()
    bench.clock.spend(0.2)
    with pytest.raises(NoAnswer, match=r"more than 4\.5 s since the heartbeat"):
        bench.lease.check_fresh()
