"""Five units on one RTU line, over the real wire: faults of some must not cost the others their period.

The period is the default one, and the timeout half of it: were each miss to cost that, three would cost a period and a
half.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import asynccontextmanager

import numpy as np
import pytest

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from simulators.devices import M7015, RtuLine
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

PERIOD_S, TIMEOUT_S = 1.0, 0.5
UNITS = range(1, 6)


class FiveUnits:
    """The five units, each with one channel of its number, and the readings of them."""

    def __init__(self) -> None:
        self.units = {unit: M7015(lambda: [21.0] * 6) for unit in UNITS}
        self.line = RtuLine(self.units)
        self.readings: list[Reading] = []
        self.notices: list[Notice] = []
        self.missed: Callable[[], int] = lambda: 0

    def of(self, unit: int, since_s: float) -> list[Reading]:
        return [r for r in self.readings if r.channel == str(unit) and r.monotonic_s >= since_s]

    def silence(self, units: Collection[int]) -> None:
        for unit in UNITS:
            self.units[unit].faults.silent = unit in units

    def told(self) -> list[tuple[str, bool]]:
        return [(notice.subject, notice.ended) for notice in self.notices]

    def assert_in_time(self, unit: int, since_s: float) -> None:
        """Good, and each interval within 20 % of the period."""
        readings = self.of(unit, since_s)
        assert {r.quality for r in readings} == {Quality.GOOD}
        intervals = np.diff([r.monotonic_s for r in readings])
        assert np.abs(intervals - PERIOD_S).max() <= 0.2 * PERIOD_S, f"unit {unit}: {intervals}"


@asynccontextmanager
async def bench() -> AsyncIterator[FiveUnits]:
    """Inside, every unit has answered often enough that its bus knows how long it takes; it is mid-period."""
    bench = FiveUnits()
    bus = make_bus("rtu", "modbus_rtu", {"port": await bench.line.start(), "timeout_s": TIMEOUT_S})
    drivers = tuple(make_device(f"d{i}", bus, "icpdas_m7015", i, {str(i): 0}, {}, SystemClock()) for i in UNITS)
    line = Line(bus, drivers, PERIOD_S)
    try:
        async with Acquisition([line], RealClock(), bench.readings.extend, bench.notices.append) as acquisition:
            runner = acquisition.runners["rtu"]
            bench.missed = lambda: runner.missed
            async with asyncio.timeout(20 * PERIOD_S):
                while len(bench.of(5, 0.0)) < 5:
                    await asyncio.sleep(0.01)
            await asyncio.sleep(PERIOD_S / 2)
            yield bench
    finally:
        await bench.line.stop()


async def test_three_fall_silent() -> None:
    async with bench() as b:
        begun = time.monotonic()
        b.silence([1, 2, 3])
        await asyncio.sleep(4.5 * PERIOD_S)
    for unit in (4, 5):
        b.assert_in_time(unit, begun - 1.2 * PERIOD_S)
    for unit in (1, 2, 3):
        assert {r.quality for r in b.of(unit, begun)} == {Quality.COMM_FAULT}
        assert b.of(unit, begun)[0].monotonic_s - begun <= 2 * PERIOD_S
    assert b.missed() == 0
    assert sorted(b.told()) == [(f"device d{unit}", False) for unit in (1, 2, 3)]


async def test_all_fall_silent_and_come_back() -> None:
    async with bench() as b:
        begun = time.monotonic()
        b.silence(UNITS)
        await asyncio.sleep(2 * PERIOD_S)
        b.silence([])
        back = time.monotonic()
        await asyncio.sleep(6.5 * PERIOD_S)
    for unit in UNITS:
        assert b.of(unit, begun)[0].quality is Quality.COMM_FAULT
        assert b.of(unit, begun)[0].monotonic_s - begun <= 2 * PERIOD_S
        assert {r.quality for r in b.of(unit, back + 4 * PERIOD_S)} == {Quality.GOOD}
    assert b.missed() == 0
    assert sorted(b.told()) == [(f"device d{unit}", ended) for unit in UNITS for ended in (False, True)]


async def test_one_intermittent_device() -> None:
    async with bench() as b:
        begun = time.monotonic()
        for period in range(8):
            b.silence([1] if period % 2 == 0 else [])
            await asyncio.sleep(PERIOD_S)
    assert {r.quality for r in b.of(1, begun)} == {Quality.GOOD, Quality.COMM_FAULT}
    for unit in (2, 3, 4, 5):
        b.assert_in_time(unit, begun - 1.2 * PERIOD_S)


async def test_one_answers_late_for_once() -> None:
    """Later than ever before, but within the time that the configuration allows."""
    async with bench() as b:
        begun = time.monotonic()
        late = [0.12]
        b.line.spoil = lambda unit, frame: ((late.pop() if unit == 2 and late else 0.0, frame),)
        await asyncio.sleep(3.5 * PERIOD_S)
    assert not late
    for unit in UNITS:
        b.assert_in_time(unit, begun - 1.2 * PERIOD_S)
    assert b.notices == []


async def test_four_turn_slow() -> None:
    """They answer within the time that the configuration allows, but with two answers per read not all within a
    period."""
    async with bench() as b:
        begun = time.monotonic()
        b.line.spoil = lambda unit, frame: ((0.15 if unit != 1 else 0.0, frame),)
        await asyncio.sleep(10 * PERIOD_S)
    for unit in UNITS:
        assert {r.quality for r in b.of(unit, begun)[2:]} == {Quality.GOOD}, "two periods until they are known as slow"
    began, ended = ({subject for subject, is_end in b.told() if is_end is end} for end in (False, True))
    assert began - ended == {"period of bus rtu"}
    assert "periods of 1 s were missed: the devices take 1." in b.notices[-1].text
    assert b.missed() >= 2
