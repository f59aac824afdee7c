"""An acquisition on real wires and a real clock, and what was heard of it."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np

from drivers.base import Quality, Reading
from gateway.acquisition import Acquisition, Line, Notice
from gateway.clock import RealClock
from gateway.plausibility import Plausible
from tests.gateway.faults.plants import Plant

PERIOD_S = 0.2
FAULT_PERIODS = 6
RETRY_MAX_PERIODS = 2


@dataclass
class Heard:
    """Everything the acquisition said."""

    readings: list[Reading] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)

    def of(self, channel: str, since: float = 0.0) -> list[Reading]:
        return [r for r in self.readings if r.channel == channel and r.monotonic_s >= since]

    async def until(self, channel: str, quality: Quality, since: float, within_s: float) -> Reading:
        """The first such reading; fails when none comes in time."""
        async with asyncio.timeout(within_s):
            while not (found := [r for r in self.of(channel, since) if r.quality is quality]):
                await asyncio.sleep(0.005)
        return found[0]


class Metronome:
    """How late this computer wakes a thread that wants nothing: what a busy machine takes, the gateway cannot give."""

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="metronome")

    def _run(self) -> None:
        while True:
            before = time.monotonic()
            if self._end.wait(0.005):
                return
            self.worst_s = max(self.worst_s, time.monotonic() - before - 0.005)

    def __enter__(self) -> "Metronome":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


@asynccontextmanager
async def acquiring(
    *plants: Plant, clock: RealClock | None = None, limits: Mapping[str, Plausible] | None = None
) -> AsyncIterator[Heard]:
    heard = Heard()
    lines = [Line(plant.bus, plant.drivers, PERIOD_S, RETRY_MAX_PERIODS, plausible=limits or {}) for plant in plants]
    try:
        async with Acquisition(lines, clock or RealClock(), heard.readings.extend, heard.notices.append):
            yield heard
    finally:
        for plant in plants:
            for stop in plant.stop:
                await stop()


def keeps_period(readings: Sequence[Reading], allowed_s: float) -> None:
    assert len(readings) >= FAULT_PERIODS - 1
    assert {r.quality for r in readings} == {Quality.GOOD}
    intervals = np.diff([r.monotonic_s for r in readings])
    late = np.percentile(np.abs(intervals - PERIOD_S), 99)
    assert late <= 0.2 * PERIOD_S + allowed_s, f"intervals {np.round(intervals, 3)}"
