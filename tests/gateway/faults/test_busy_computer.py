"""Every core is busy with other work: the periods hold, except for the time that the computer takes.

Real time, as the subject is the computer's own. Tolerance: a fifth of a period, and twice the most time that a thread
which wants nothing lost within one period, as this test measures it.
"""

import asyncio
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.base import Quality
from tests.benches.faults.actions import PERIOD_S
from tests.benches.faults.bench import acquiring, keeps_period
from tests.benches.faults.plants import PLANTS

pytestmark = pytest.mark.realtime

LASTS_S = 8 * PERIOD_S
ONE_AFTER_THE_OTHER_S = 0.037
"""Between the starts, lest all wires be busy at the same moment of each period."""
TIMER_S = 0.001
"""Every timer is late by that much; it is no sign of a busy computer."""


class Metronome:
    """How late this computer wakes a thread that wants nothing: what a busy machine takes, the gateway cannot give."""

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="metronome")

    def lost_s(self, begin_s: float = 0.0, end_s: float = float("inf")) -> float:
        """The most time that it lost within one period, of what ended between these monotonic times.

        In sum, because a read is a chain of threads that wake each other, and each may be late.
        """
        window: deque[tuple[float, float]] = deque()
        lost = most = 0.0
        for at, late in self._late:
            if begin_s <= at <= end_s:
                window.append((at, late))
                lost += late
                while window[0][0] < at - PERIOD_S:
                    lost -= window.popleft()[1]
                most = max(most, lost)
        return most

    def _run(self) -> None:
        while True:
            before = time.monotonic()
            if self._end.wait(0.005):
                return
            now = time.monotonic()
            if (late := now - before - 0.005) > TIMER_S:
                self._late.append((now, late))

    def __enter__(self) -> "Metronome":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


@contextmanager
def busy_computer(processes: int) -> Iterator[None]:
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


async def test_every_core_is_busy(tmp_path: Path) -> None:
    with Metronome() as metronome, busy_computer(2):
        async with asyncio.TaskGroup() as tasks:
            for name in PLANTS:
                tasks.create_task(beside_others(name, tmp_path / name, metronome), name=name)
                await asyncio.sleep(ONE_AFTER_THE_OTHER_S)


async def beside_others(name: str, folder: Path, metronome: Metronome) -> None:
    await asyncio.to_thread(folder.mkdir)
    plant = await PLANTS[name](folder, PERIOD_S)  # who has to wait for a core has not met a dead device
    async with acquiring(plant) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, 5.0)
        await asyncio.sleep(PERIOD_S)
        begun = time.monotonic()
        await asyncio.sleep(LASTS_S)
    # Whose answer had to wait for a core is asked again, and may have to wait again.
    keeps_period(heard.of("victim", begun), 2 * metronome.lost_s(begun))
