"""Many faults in a row leave nothing behind: no descriptor, thread or task, and no growing memory.

Every row of the fault matrix on every wire, one after the other, each until it is seen and mended; four rounds, of
which two are measured: the bound is per fault, so more rounds find no less. No hour is simulated: what grows slowly,
and only with time, is not found here.
"""

import asyncio
import gc
import logging
import threading
import time
import tracemalloc
from collections.abc import Sequence
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.faults.actions import restarted, whole
from tests.benches.faults.can_plants import HEARTBEAT_MS
from tests.benches.faults.matrix import HARMLESS, MATRIX
from tests.benches.faults.plant import FaultyPlant
from tests.benches.faults.plants import PLANTS
from tests.benches.faults.play import done
from tests.benches.processes import open_links

PERIOD_S = 0.05
WARM_UP, ROUNDS = 2, 2
LONGEST_WAIT_S = 120.0
WIRES = {
    "modbus": ("rtu", "tcp"),
    "can": ("slcan", "heartbeat", "dbc"),
    "displacement": ("me_rs485", "me_ethernet"),
}


class Latest:
    """Keeps the newest reading of the victim and counts what was reported; stores nothing that grows."""

    def __init__(self) -> None:
        self._reading: Reading | None = None
        self.told = 0

    def put(self, readings: Sequence[Reading]) -> None:
        for reading in readings:
            if reading.channel == "victim":
                self._reading = reading

    def note(self, _: Notice) -> None:
        self.told += 1

    async def until(self, quality: Quality, says: str = "", where: str = "") -> None:
        """A reading that comes from now on. Raises AssertionError when none comes."""
        before = now = self._reading
        end_s = time.monotonic() + LONGEST_WAIT_S
        while now is None or now is before or now.quality is not quality or says not in now.detail:
            assert time.monotonic() < end_s, f"{where}: no reading is {quality} and says {says!r}: {now}"
            await asyncio.sleep(0.005)
            now = self._reading


def held() -> tuple[int, int, int]:
    """Descriptors, threads and tasks of this process; simulated time itself keeps one descriptor open for each
    thread."""
    held_open = sum("/task" not in link for link in open_links())
    return held_open, threading.active_count(), len(asyncio.all_tasks())


async def all_faults(name: str, plant: FaultyPlant, latest: Latest) -> int:
    """Inflict all faults one after the other, each until it is seen and mended; returns how many."""
    cases = [case for case in MATRIX if case.plant == name]
    # A restart between two reads is timed by the matrix's longer period.
    harmless = [case for case in HARMLESS if case.plant == name and case.disturb is not restarted]
    for case in cases:
        if plant.node is not None:  # a heartbeat that has never come since the node was connected cannot be lost
            await asyncio.sleep(2e-3 * HEARTBEAT_MS)
        await done(case.start, plant)
        await latest.until(case.quality, case.then, f"{name}, {case.fault}")
        await done(case.end, plant)
        await mended(plant, latest, f"{name}, after {case.fault}")
    for disturbance in harmless:
        await done(disturbance.disturb, plant)
        await mended(plant, latest, f"{name}, after {disturbance.disturbance}")
    return len(cases) + len(harmless)


async def mended(plant: FaultyPlant, latest: Latest, where: str) -> None:
    await latest.until(Quality.GOOD, where=where)
    if plant.wire is not None:
        whole(plant)


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.parametrize("wires", WIRES)
async def test_nothing_grows(tmp_path: Path, wires: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, logger="gateway.acquisition.runner")  # pytest keeps every record
    plants: dict[str, tuple[FaultyPlant, Latest]] = {}
    tracemalloc.start()  # before anything is made: what is made for each fault takes the place of what was there
    async with AsyncExitStack() as stack:
        for name in WIRES[wires]:
            (tmp_path / name).mkdir()
            plant, latest = await PLANTS[name](tmp_path / name), Latest()
            for stop in plant.stop:
                stack.push_async_callback(stop)
            for said in plant.said:
                said.steady = True  # nor does the test remember anything
            line = Line(plant.bus, plant.drivers, PERIOD_S, retry_max_periods=2)
            await stack.enter_async_context(Acquisition([line], RealClock(), latest.put, latest.note))
            await latest.until(Quality.GOOD)
            plants[name] = plant, latest

        async def a_round() -> int:
            return sum(await asyncio.gather(*(all_faults(name, *each) for name, each in plants.items())))

        for _ in range(WARM_UP):
            await a_round()
        before = held()
        gc.collect()
        for _ in range(2):  # what is kept once does not grow again
            start = tracemalloc.get_traced_memory()[0]
            faults = sum([await a_round() for _ in range(ROUNDS)])
            gc.collect()
            if (grown := tracemalloc.get_traced_memory()[0] - start) < 100 * faults:
                break
        tracemalloc.stop()
        after = held()
    print(f"{faults} faults: {before} became {after}, {grown} bytes more")
    assert all(latest.told >= 6 for _, latest in plants.values())
    assert [b - a for a, b in zip(before, after, strict=True)] == pytest.approx([0, 0, 0], abs=1)
    assert grown < 100 * faults, f"{grown} bytes in {faults} faults"
