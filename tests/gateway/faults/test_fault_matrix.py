"""The fault matrix: each fault over a real wire, with the gateway's acquisition on the other end.

For each fault the channel's quality changes within two periods, the neighbour on the wire and the other bus keep their
period, recovery needs nobody, each problem is reported once, and no channel ever shows what belongs to an older
request: each device sends a different number each time, and knows when it sent which. All faults of a wire are played
at once, each on its own wire.
"""

import asyncio
import time
from functools import partial
from pathlib import Path

import pytest

from drivers.base import Quality
from tests.benches.faults.actions import LONG_TIMEOUT_S, PERIOD_S, silent, talking
from tests.benches.faults.bench import FAULT_PERIODS, acquiring, keeps_period, logged, shows_what_was_said
from tests.benches.faults.matrix import ASKED, COMM, MATRIX, Case
from tests.benches.faults.plants import PLANTS, other
from tests.benches.faults.play import all_at_once, done

pytestmark = pytest.mark.simulated_time

MANY_THREADS = ("multicast", "timer", "sync", "dbc")
"""Plants whose cases together have dozens of threads, which simulated time has to look after."""
LEARNING_PERIODS = 5
"""After this many polls a bus knows how long its devices take, and waits no longer for a silent one."""


@pytest.mark.parametrize(
    "plant", [pytest.param(name, marks=[pytest.mark.slow] * (name in MANY_THREADS)) for name in PLANTS]
)
async def test_every_fault_of(plant: str, tmp_path: Path) -> None:
    cases = [case for case in MATRIX if case.plant == plant]
    with logged():
        await all_at_once({case.fault: partial(play, case) for case in cases}, tmp_path)


async def play(case: Case, folder: Path) -> None:
    plant, beside = await PLANTS[case.plant](folder, case.timeout_s), await other()
    async with acquiring(plant, beside) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        await asyncio.sleep((LEARNING_PERIODS + 0.5) * PERIOD_S)  # nothing is under way
        begun = time.monotonic()
        await done(case.start, plant)
        turned = await heard.until("victim", case.quality, begun, 5.0)
        await asyncio.sleep(FAULT_PERIODS * PERIOD_S)
        ended = time.monotonic()
        during = [r for r in heard.of("victim", turned.monotonic_s) if r.monotonic_s < ended]
        await done(case.end, plant)
        await heard.until("victim", Quality.GOOD, ended, 5.0)
        await asyncio.sleep(PERIOD_S)
    assert turned.monotonic_s - begun <= 2 * PERIOD_S
    assert Quality.GOOD not in {r.quality for r in during}
    assert any(part in turned.detail for part in case.says.split("|")), f"{turned.detail!r} does not say {case.says!r}"
    shows_what_was_said(plant, heard)
    shows_what_was_said(beside, heard)
    keeps_period([r for r in heard.of("other") if begun <= r.monotonic_s < ended])
    if not case.whole_bus and len(plant.drivers) > 1:
        keeps_period([r for r in heard.of("neighbour") if begun <= r.monotonic_s < ended])
    if case.whole_device:
        assert {r.quality for r in heard.of("beside", turned.monotonic_s) if r.monotonic_s < ended} == {case.quality}
    elif case.in_part:
        assert [r.quality for r in heard.of("beside", turned.monotonic_s) if r.monotonic_s < ended][-1] is Quality.GOOD
    elif case.quality is not COMM and "beside" in plant.drivers[0].channels:
        assert {r.quality for r in heard.of("beside")} == {Quality.GOOD}
    told: dict[str, int] = {}
    for notice in heard.notices:
        if not notice.ended:
            told[notice.subject] = told.get(notice.subject, 0) + 1
    assert told, "nothing was reported"
    assert case.then in during[-1].detail
    assert max(told.values()) <= (2 if case.then else 1), f"reported more than once: {heard.notices}"
    assert len(heard.log) == len(heard.notices), f"the log says {heard.log}"  # beginnings and ends


@pytest.mark.slow
async def test_intermittent_device_takes_no_time_of_its_neighbours(tmp_path: Path) -> None:
    """With a timeout of half a period; it changes at every moment of a period, also in the middle of a poll."""
    with logged():
        await all_at_once({plant: partial(comes_and_goes, plant) for plant in ASKED}, tmp_path)


async def comes_and_goes(name: str, folder: Path) -> None:
    plant, beside = await PLANTS[name](folder, LONG_TIMEOUT_S), await other()
    async with acquiring(plant, beside) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        await asyncio.sleep(LEARNING_PERIODS * PERIOD_S)
        begun = time.monotonic()
        for _ in range(FAULT_PERIODS):
            silent(plant)
            await asyncio.sleep(1.6 * PERIOD_S)
            talking(plant)
            await asyncio.sleep(1.2 * PERIOD_S)
        ended = time.monotonic()
        await heard.until("victim", Quality.GOOD, ended, 5.0)
    for channel in ("neighbour", "other"):
        keeps_period([r for r in heard.of(channel) if begun <= r.monotonic_s < ended])
    during = [r.quality for r in heard.of("victim", begun)]
    assert during.count(COMM) >= FAULT_PERIODS // 2
    assert during.count(Quality.GOOD) >= FAULT_PERIODS // 2
    shows_what_was_said(plant, heard)
