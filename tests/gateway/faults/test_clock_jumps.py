"""Every wire while the computer's wall clock jumps by an hour, forwards and back."""

import asyncio
import time
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.board import Board
from tests.benches.faults.actions import PERIOD_S
from tests.benches.faults.bench import acquiring, keeps_period, shows_what_was_said
from tests.benches.faults.plants import PLANTS
from tests.benches.faults.play import all_at_once
from tests.benches.simulated_time import jump_wall_clock

pytestmark = pytest.mark.simulated_time

HOUR_S = 3600
LASTS_S = 5 * PERIOD_S
CLOSES_S = 1.0
"""Closing takes no longer than ending a thread and closing an adapter's channel."""
WAITING_S = 0.15
"""After this time the receiver on the bus is waiting for the next frame."""


@pytest.mark.slow
async def test_periods_and_ages_stay_and_buses_open_and_close(tmp_path: Path) -> None:
    await all_at_once({name: partial(jumped, name) for name in PLANTS}, tmp_path)


async def jumped(name: str, folder: Path) -> None:
    plant = await PLANTS[name](folder)
    for _ in range(2):
        for seconds in (HOUR_S, -HOUR_S):
            await plant.bus.connect()
            await asyncio.sleep(WAITING_S)
            jump_wall_clock(seconds)
            begun = time.monotonic()
            await plant.bus.close()
            assert time.monotonic() - begun < CLOSES_S, "closing took too long"
    board = Board({"victim": PERIOD_S, "beside": PERIOD_S, "neighbour": PERIOD_S})
    async with acquiring(plant) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        await asyncio.sleep(3 * PERIOD_S)
        for seconds in (HOUR_S, -HOUR_S):
            jump_wall_clock(seconds)
            await asyncio.sleep(LASTS_S)
        board.put(heard.readings)
        latest = board.latest("victim", time.monotonic())
        begun = time.monotonic()
    assert time.monotonic() - begun < 2 * CLOSES_S, "ending took too long"
    keeps_period(heard.of("victim")[2:])
    assert heard.notices == []
    shows_what_was_said(plant, heard)
    assert latest is not None
    assert latest.reading.quality is Quality.GOOD
    assert latest.age_s < 2 * PERIOD_S
    jumps = utc_jumps(heard.of("victim"))
    assert max(jumps) > 0.9 * HOUR_S, "forwards, perhaps together with other wires' jumps"
    assert min(jumps) < -0.9 * HOUR_S, "back"


def utc_jumps(readings: Sequence[Reading]) -> list[float]:
    """By how many seconds more than the monotonic time each reading's UTC is later than the one before."""
    return [
        (b.source_time - a.source_time).total_seconds() - (b.monotonic_s - a.monotonic_s) for a, b in pairwise(readings)
    ]
