"""An acquisition on real wires, and a record of what it reported."""

import asyncio
import logging
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import numpy as np

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.config.sections import Limits
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.faults.actions import PERIOD_S
from tests.benches.faults.plant import FaultyPlant

FAULT_PERIODS = 6
RETRY_MAX_PERIODS = 2
RESOLUTION = 0.06
"""Half of the devices' resolution, degC or µm."""


@dataclass
class HeardSamples:
    """Everything the acquisition said, but for what is no problem."""

    readings: list[Reading] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    _news: asyncio.Event = field(default_factory=asyncio.Event)

    def put(self, readings: Sequence[Reading]) -> None:
        """Take the readings of one device."""
        self.readings.extend(readings)
        self._news.set()

    def note(self, notice: Notice) -> None:
        """Take a problem that began or ended."""
        if not notice.is_fact:
            self.notices.append(notice)

    def of(self, channel: str, since: float = 0.0) -> list[Reading]:
        return [r for r in self.readings if r.channel == channel and r.monotonic_s >= since]

    async def until(self, channel: str, quality: Quality, since: float, within_s: float) -> Reading:
        """The first such reading; fails when none comes in time."""
        async with asyncio.timeout(within_s):
            while not (found := [r for r in self.of(channel, since) if r.quality is quality]):
                self._news.clear()
                await self._news.wait()
        return found[0]


class _ToItsPlant(logging.Handler):
    """Passes each acquisition's warnings to the record of its own plant, because several run at once."""

    def emit(self, record: logging.LogRecord) -> None:
        _log.get().append(record.getMessage())


_log: ContextVar[list[str]] = ContextVar("log")


@contextmanager
def logged() -> Iterator[None]:
    """Inside, `Heard.log` is filled."""
    logger, handler = logging.getLogger("gateway.acquisition.runner"), _ToItsPlant(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


@asynccontextmanager
async def acquiring(*plants: FaultyPlant, limits: Mapping[str, Limits] | None = None) -> AsyncIterator[HeardSamples]:
    heard = HeardSamples()
    _log.set(heard.log)
    lines = [Line(plant.bus, plant.drivers, PERIOD_S, RETRY_MAX_PERIODS, plausible=limits or {}) for plant in plants]
    try:
        async with Acquisition(lines, RealClock(), heard.put, heard.note):
            yield heard
    finally:
        for plant in plants:
            for stop in plant.stop:
                await stop()


def shows_what_was_said(plant: FaultyPlant, heard: HeardSamples) -> None:
    """No good reading shows a value that belongs to an older request, or to none."""
    for driver, source in zip(plant.drivers, plant.said, strict=True):
        for channel in driver.channels:
            before_s = 0.0
            for reading in heard.of(channel):
                said = source.between(before_s, reading.monotonic_s)[-1 if plant.last_word else 0 :]
                if reading.quality is Quality.GOOD:
                    right = [value for value in said if abs(value - reading.value) <= RESOLUTION]
                    assert right, f"{channel} shows {reading.value:.4g}; since the last reading, {said} was said"
                before_s = reading.monotonic_s


def keeps_period(readings: Sequence[Reading], allowed_s: float = 0.0) -> None:
    """Every reading good, and none more than a fifth of a period out of time.

    allowed_s: how much more, s
    """
    assert len(readings) >= FAULT_PERIODS - 1
    assert {r.quality for r in readings} == {Quality.GOOD}
    intervals = np.diff([r.monotonic_s for r in readings])
    late = np.percentile(np.abs(intervals - PERIOD_S), 99)
    assert late <= 0.2 * PERIOD_S + allowed_s, f"intervals {np.round(intervals, 3)}"
