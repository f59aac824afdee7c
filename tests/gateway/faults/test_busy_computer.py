"""Every core is busy with other work: the periods hold, except for the time that the computer takes.

Real time, because the subject is the computer's own time. Tolerance: a fifth of a period, and what the computer took
within one period at the most, as this test measures it: twice the time that a thread which wants nothing lost, and the
time that the event loop's thread, and the one of the others that waited the longest, were ready to run and had no core.
Where that is a whole period, as beside a dozen busy programs, a device cannot answer in time; then all that is asked
for is that it is heard again.
"""

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from drivers.base import Quality
from tests.benches.faults.actions import PERIOD_S
from tests.benches.faults.bench import acquiring, keeps_period
from tests.benches.faults.plants import PLANTS

pytestmark = pytest.mark.realtime

READINGS = 8
LONGEST_S = 120.0
"""The limit for these readings: other work may take most of the computer."""
ONE_AFTER_THE_OTHER_S = 0.037
"""The pause between the starts, so that not all wires are busy at the same moment of each period."""
TIMER_S = 0.001
"""Every timer is late by this much; that is not a sign of a busy computer."""


def waited_s() -> dict[int, float]:
    """How long each of this process's threads has been ready to run and had no core, as Linux counts it."""
    found = {}
    for thread in Path("/proc/self/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
            found[int(thread.name)] = int((thread / "schedstat").read_text(encoding="ascii").split()[1]) * 1e-9
    return found


class Metronome:
    """How late this computer wakes a thread that wants nothing, and how long the event loop's thread and one that reads
    for it wait for a core: what a busy machine takes, the gateway cannot give."""

    def __init__(self) -> None:
        self._late: list[tuple[float, float]] = []
        self._waited: list[tuple[float, float]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="metronome")

    def lost_s(self, begin_s: float) -> float:
        """The most time that the computer took within one period that ended after this monotonic time.

        In sum, because a read is a chain of threads that wake each other, and each may be late. A device whose answer
        had to wait for a core is asked again, and may have to wait again: hence twice.
        """
        return 2 * _most_s(self._late, begin_s) + _most_s(self._waited, begin_s)

    def _run(self) -> None:
        waited = waited_s()
        while True:
            before = time.monotonic()
            if self._end.wait(0.005):
                return
            now = time.monotonic()
            if (late := now - before - 0.005) > TIMER_S:
                self._late.append((now, late))
            then, waited = waited, waited_s()
            grown = {thread: total - then.get(thread, total) for thread, total in waited.items()}
            loop_s = grown.pop(os.getpid(), 0.0)
            grown.pop(threading.get_native_id(), None)
            self._waited.append((now, loop_s + max(grown.values(), default=0.0)))

    def __enter__(self) -> "Metronome":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def _most_s(taken: Sequence[tuple[float, float]], begin_s: float) -> float:
    """The largest sum within one period, of (monotonic time, s)."""
    window: deque[tuple[float, float]] = deque()
    lost = most = 0.0
    for at, late in taken:
        if at >= begin_s:
            window.append((at, late))
            lost += late
            while window[0][0] < at - PERIOD_S:
                lost -= window.popleft()[1]
            most = max(most, lost)
    return most


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
    all_run = asyncio.Barrier(len(PLANTS))
    with Metronome() as metronome, busy_computer(2):
        async with asyncio.TaskGroup() as tasks:
            for name in PLANTS:
                tasks.create_task(beside_others(name, tmp_path / name, metronome, all_run), name=name)
                await asyncio.sleep(ONE_AFTER_THE_OTHER_S)


async def beside_others(name: str, folder: Path, metronome: Metronome, all_run: asyncio.Barrier) -> None:
    await asyncio.to_thread(folder.mkdir)
    plant = await PLANTS[name](folder, PERIOD_S)  # having to wait for a core does not mean a dead device
    async with acquiring(plant) as heard:
        await heard.until("victim", Quality.GOOD, 0.0, LONGEST_S)
        await all_run.wait()  # making a bus loads its library, which takes the event loop's time
        await asyncio.sleep(PERIOD_S)
        begun = time.monotonic()
        async with asyncio.timeout(LONGEST_S):
            while len(heard.of("victim", begun)) < READINGS:
                await asyncio.sleep(PERIOD_S / 4)
        lost_s = metronome.lost_s(begun)
        if lost_s >= PERIOD_S:
            await heard.until("victim", Quality.GOOD, time.monotonic(), LONGEST_S)
            return
    keeps_period(heard.of("victim", begun), lost_s)
