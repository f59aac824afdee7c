"""What must not touch a value: noise between frames, storms, a jumping wall clock, a busy computer; a frozen one."""

import asyncio
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from drivers.base import Quality
from gateway.board import Board
from gateway.clock import RealClock
from gateway.plausibility import Plausible
from simulators.devices.spoil import Spoil
from tests.gateway.faults.bench import PERIOD_S, Metronome, acquiring, keeps_period
from tests.gateway.faults.plants import PLANTS, VICTIM, Plant, rtu, slcan, tcp

LASTS_S = 8 * PERIOD_S
EMERGENCY = bytes.fromhex("00 10 01 00 00 00 00 00")


class JumpingClock(RealClock):
    """Its UTC is set by the test, as NTP or a person sets a computer's."""

    def __init__(self) -> None:
        self.jump = timedelta()

    def utc(self) -> datetime:
        return datetime.now(UTC) + self.jump


async def test_garbage_between_frames_is_passed_over(tmp_path: Path) -> None:
    plant = await rtu(tmp_path)
    assert plant.wire is not None
    garbage: Spoil = lambda _, frame: [(0.0, b"\x00\xff\x01\x04" + frame + b"\x01\x84\x02")]  # noqa: E731
    plant.wire.spoil = garbage
    with Metronome() as metronome:
        async with acquiring(plant) as heard:
            await asyncio.sleep(LASTS_S)
    assert {r.value for r in heard.readings} == {21.0}
    keeps_period(heard.of("neighbour"), metronome.worst_s)
    assert heard.notices == []


async def test_storm_of_emergencies(tmp_path: Path) -> None:
    plant = await slcan(tmp_path)
    adapter = plant.adapter
    assert adapter is not None

    async def storm() -> None:
        while True:
            adapter.send([(0x80 + VICTIM, EMERGENCY)] * 10)
            await asyncio.sleep(0.005)

    with Metronome() as metronome:
        async with acquiring(plant) as heard:
            await heard.until("neighbour", Quality.GOOD, 0.0, 5.0)
            task, begun = asyncio.create_task(storm()), time.monotonic()
            await asyncio.sleep(LASTS_S)
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
    for channel in ("victim", "neighbour"):
        keeps_period(heard.of(channel, begun), metronome.worst_s)
    assert heard.notices == []


@pytest.mark.parametrize("hours", [1, -1])
async def test_wall_clock_jumps(tmp_path: Path, hours: int) -> None:
    plant, clock = await tcp(tmp_path), JumpingClock()
    board = Board({"victim": PERIOD_S, "beside": PERIOD_S, "neighbour": PERIOD_S})
    with Metronome() as metronome:
        async with acquiring(plant, clock=clock) as heard:
            await heard.until("victim", Quality.GOOD, 0.0, 5.0)
            await asyncio.sleep(3 * PERIOD_S)
            clock.jump = timedelta(hours=hours)
            await asyncio.sleep(LASTS_S)
            board.put(heard.readings)
            latest = board.latest("victim", time.monotonic())
    keeps_period(heard.of("victim"), metronome.worst_s)
    assert latest is not None
    assert latest.reading.quality is Quality.GOOD
    assert latest.age_s < 2 * PERIOD_S + metronome.worst_s


@contextmanager
def busy_computer(processes: int) -> Iterator[None]:
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


@pytest.mark.parametrize("plant_of", [rtu, tcp, slcan])
async def test_every_core_is_busy(tmp_path: Path, plant_of: Callable[[Path], Awaitable[Plant]]) -> None:
    plant = await plant_of(tmp_path)
    with Metronome() as metronome, busy_computer(2):
        async with acquiring(plant) as heard:
            await heard.until("neighbour", Quality.GOOD, 0.0, 5.0)
            begun = time.monotonic()
            await asyncio.sleep(LASTS_S)
    keeps_period(heard.of("neighbour", begun), 2 * metronome.worst_s)


@pytest.mark.parametrize("kind", PLANTS)
async def test_frozen_value_is_told_and_only_that_channel(tmp_path: Path, kind: str) -> None:
    plant = await PLANTS[kind](tmp_path)
    after_s = 3 * PERIOD_S
    limits = {"victim": Plausible(stuck_after_s=after_s)}
    with Metronome() as metronome:
        async with acquiring(plant, limits=limits) as heard:
            first = await heard.until("victim", Quality.GOOD, 0.0, 5.0)
            frozen = await heard.until("victim", Quality.STALE, 0.0, 5.0)
            await asyncio.sleep(3 * PERIOD_S)
    assert frozen.monotonic_s - first.monotonic_s <= after_s + 2 * PERIOD_S + metronome.worst_s
    assert {r.quality for r in heard.readings if r.channel != "victim"} <= {Quality.GOOD}
    assert [n.subject for n in heard.notices] == ["channel victim"]
