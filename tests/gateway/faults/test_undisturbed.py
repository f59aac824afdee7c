"""Disturbances that must not affect a value (noise between frames, storms), and a frozen value."""

import asyncio
import time
from functools import partial
from pathlib import Path

import pytest

from drivers.base import Quality
from gateway.config.sections import Limits
from tests.benches.faults.actions import PERIOD_S
from tests.benches.faults.bench import FAULT_PERIODS, acquiring, keeps_period, shows_what_was_said
from tests.benches.faults.matrix import HARMLESS, Harmless
from tests.benches.faults.plants import PLANTS
from tests.benches.faults.play import all_at_once, done

pytestmark = pytest.mark.simulated_time


@pytest.mark.slow
@pytest.mark.parametrize("disturbance", sorted({case.disturbance for case in HARMLESS}))
async def test_no_reading_shows(disturbance: str, tmp_path: Path) -> None:
    cases = [case for case in HARMLESS if case.disturbance == disturbance]
    await all_at_once({case.plant: partial(undisturbed, case) for case in cases}, tmp_path)


async def undisturbed(case: Harmless, folder: Path) -> None:
    plant = await PLANTS[case.plant](folder)
    async with acquiring(plant) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        await asyncio.sleep(2 * PERIOD_S)  # the first period is longer: every device is checked
        begun = time.monotonic()
        for _ in range(FAULT_PERIODS):
            await done(case.disturb, plant)
            await asyncio.sleep(PERIOD_S)
    assert heard.notices == []
    assert {r.quality for r in heard.readings} == {Quality.GOOD}
    shows_what_was_said(plant, heard)
    for channel in ("victim", "neighbour") if len(plant.drivers) > 1 else ("victim",):
        keeps_period(heard.of(channel, begun))


@pytest.mark.slow
async def test_frozen_value_is_reported_and_only_that_channel(tmp_path: Path) -> None:
    await all_at_once({plant: partial(frozen, plant) for plant in PLANTS}, tmp_path)


async def frozen(name: str, folder: Path) -> None:
    plant = await PLANTS[name](folder)
    for said in plant.said:
        said.steady = True
    after_s = 3 * PERIOD_S
    async with acquiring(plant, limits={"victim": Limits(stuck_after_s=after_s)}) as heard:
        first = await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        stale = await heard.until("victim", Quality.STALE, 0.0, 5.0)
        await asyncio.sleep(3 * PERIOD_S)
    assert stale.monotonic_s - first.monotonic_s <= after_s + 2 * PERIOD_S
    assert {r.quality for r in heard.readings if r.channel != "victim"} <= {Quality.GOOD}
    assert [n.subject for n in heard.notices] == ["channel victim"]
