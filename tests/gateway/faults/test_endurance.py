"""Many faults in a row leave nothing behind: no descriptor, thread, task, nor memory that grows with each."""

import asyncio
import gc
import logging
import threading
import tracemalloc
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition import Acquisition, Line, Notice
from gateway.clock import RealClock
from simulators.devices.source import Fault
from tests.gateway.faults.plants import Plant, dbc, rtu, slcan, tcp, timer

PERIOD_S = 0.05
WARM_UP, CYCLES = 5, 40
"""A day on a bad shop floor has some dozen faults; here they come one after the other."""


class Latest:
    """Keeps the newest quality of each channel and counts what was told; nothing that grows."""

    def __init__(self) -> None:
        self.quality: dict[str, Quality] = {}
        self.told = 0

    def put(self, readings: list[Reading]) -> None:
        self.quality |= {r.channel: r.quality for r in readings}

    def note(self, _: Notice) -> None:
        self.told += 1

    async def until(self, quality: Quality) -> None:
        async with asyncio.timeout(10):
            while self.quality.get("victim") is not quality:
                await asyncio.sleep(0.005)


def held() -> tuple[int, int, int]:
    """Descriptors, threads and tasks of this process."""
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count(), len(asyncio.all_tasks())


async def cycle(plant: Plant, latest: Latest) -> None:
    """One round of faults, each until it is seen and mended."""
    await plant.unplug()
    await latest.until(Quality.COMM_FAULT)
    await plant.plug()
    await latest.until(Quality.GOOD)
    plant.faults.silent = True
    await latest.until(Quality.COMM_FAULT)
    plant.faults.silent = False
    await latest.until(Quality.GOOD)
    plant.faults.set(0, Fault.OPEN)
    await latest.until(Quality.SENSOR_FAULT)
    plant.faults.set(0, None)
    await latest.until(Quality.GOOD)


@pytest.mark.slow
@pytest.mark.parametrize("plant_of", [rtu, tcp, slcan, timer, dbc])
async def test_nothing_grows(
    tmp_path: Path, plant_of: Callable[[Path], Awaitable[Plant]], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL, logger="gateway.acquisition")  # pytest keeps every record
    plant, latest = await plant_of(tmp_path), Latest()
    for said in plant.said:
        said.steady = True  # nor does the test remember anything
    line = Line(plant.bus, plant.drivers, PERIOD_S, retry_max_periods=2)
    async with Acquisition([line], RealClock(), lambda readings: latest.put(list(readings)), latest.note):
        await latest.until(Quality.GOOD)
        for _ in range(WARM_UP):
            await cycle(plant, latest)
        before = held()
        tracemalloc.start()
        gc.collect()
        start = tracemalloc.get_traced_memory()[0]
        for _ in range(CYCLES):
            await cycle(plant, latest)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - start
        tracemalloc.stop()
        after = held()
    for stop in plant.stop:
        await stop()
    assert latest.told >= 6
    assert [b - a for a, b in zip(before, after, strict=True)] == pytest.approx([0, 0, 0], abs=1)
    assert grown < 2000 * CYCLES, f"{grown} bytes in {CYCLES} cycles"
