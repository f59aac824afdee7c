"""Three units on one RTU line, over the real wire; a seed decides how the middle one's answers are disturbed."""

import asyncio
import random
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

import numpy as np

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from simulators.devices import M7015, RtuLine
from simulators.devices.modbus_servers import crc16
from simulators.devices.pta8d08 import Pta8d08
from tests.benches.buses import make_bus

PERIOD_S, TIMEOUT_S, PERIODS = 1.0, 0.4, 60
UNITS, DISTURBED = (1, 2, 3), 2
_FIRST_DEGC, _DEGC_PER_S = -15.0, 1.5
_LEARNT_PERIODS = 6

Sent = Sequence[tuple[float, bytes]]
Disturb = Callable[[random.Random, bytes], Sent]


def flipped(share: float) -> Disturb:
    """One bit of this share of the answers is flipped."""

    def disturb(draw: random.Random, frame: bytes) -> Sent:
        if draw.random() >= share:
            return [(0.0, frame)]
        bit = draw.randrange(8 * len(frame))
        spoilt = bytearray(frame)
        spoilt[bit // 8] ^= 1 << bit % 8
        return [(0.0, bytes(spoilt))]

    return disturb


def lost(share: float) -> Disturb:
    """This share of the answers is lost."""
    return lambda draw, frame: [] if draw.random() < share else [(0.0, frame)]


def busy(share: float) -> Disturb:
    """For this share of the requests the unit says that it is busy (exception 6) instead of answering."""

    def disturb(draw: random.Random, frame: bytes) -> Sent:
        refusal = bytes((frame[0], frame[1] | 0x80, 6))
        return [(0.0, refusal + crc16(refusal) if draw.random() < share else frame)]

    return disturb


def late(share: float, by_s: float) -> Disturb:
    """This share of the answers is late; the unit answers what it is asked meanwhile."""
    return lambda draw, frame: [(by_s if draw.random() < share else 0.0, frame)]


def slow(share: float, by_s: float) -> Disturb:
    """The same, but the unit answers in order: it is busy meanwhile."""
    free_s = 0.0

    def disturb(draw: random.Random, frame: bytes) -> Sent:
        nonlocal free_s
        now = time.monotonic()
        free_s = max(free_s, now) + (by_s if draw.random() < share else 0.0)
        return [(free_s - now, frame)]

    return disturb


def least_lost(seed: int, share: float, by_s: float, requests: int) -> int:
    """How many of 60 periods any master loses on a line that is `slow` if it needs this many answers in each period.

    It sends each request once, knows which answer is whose, and so waits only for the unit.
    """
    draw, free_s, lost_periods = random.Random(seed), 0.0, 0
    for period in range(PERIODS):
        begin_s = PERIOD_S * period
        for _ in range(requests):
            free_s = max(begin_s, free_s) + (by_s if draw.random() < share else 0.0)
        lost_periods += free_s > begin_s + PERIOD_S
    return lost_periods


class Bench:
    """The line, and what was read of its units."""

    def __init__(self, device: type[M7015 | Pta8d08], profile: str) -> None:
        self.began_s = time.monotonic()
        channels = 6 if device is M7015 else 8
        self.units = {unit: device(lambda: [self.true_degC(time.monotonic())] * channels) for unit in UNITS}
        self.line = RtuLine(self.units)
        self.profile = profile
        self.path = ""
        self.readings: list[Reading] = []
        self.notices: list[Notice] = []
        self.answers = 0

    def true_degC(self, monotonic_s: float) -> float:
        """What every channel measures at that time: it rises, so that a value tells when it was measured."""
        return _FIRST_DEGC + _DEGC_PER_S * (monotonic_s - self.began_s)

    def disturb(self, how: Disturb, seed: int) -> None:
        """From now on the middle unit's answers are disturbed."""
        draw = random.Random(seed)

        def spoil(unit: int, frame: bytes) -> Sent:
            if unit != DISTURBED:
                return [(0.0, frame)]
            self.answers += 1
            return how(draw, frame)

        self.line.spoil = spoil

    def of(self, unit: int) -> list[Reading]:
        return [r for r in self.readings if r.channel == str(unit)]

    def lost(self) -> int:
        """How many of the middle unit's readings have no value."""
        return sum(r.quality is not Quality.GOOD for r in self.of(DISTURBED))

    def assert_true(self) -> None:
        """Each value was measured at most a period before its time, within half a step."""
        for reading in self.readings:
            if reading.quality.usable:
                low, high = (self.true_degC(reading.monotonic_s - age_s) for age_s in (PERIOD_S, 0.0))
                assert low - 0.06 <= reading.value <= high + 0.06, reading

    def assert_neighbours_in_time(self) -> None:
        """Good, and each interval within 20 % of the period."""
        for unit in UNITS:
            if unit != DISTURBED:
                assert {r.quality for r in self.of(unit)} == {Quality.GOOD}
                intervals = np.diff([r.monotonic_s for r in self.of(unit)])
                assert np.abs(intervals - PERIOD_S).max() <= 0.2 * PERIOD_S, f"unit {unit}: {intervals}"


@asynccontextmanager
async def disturbed(
    how: Disturb,
    seed: int,
    device: type[M7015 | Pta8d08] = M7015,
    profile: str = "icpdas_m7015",
    timeout_s: float | None = TIMEOUT_S,
) -> AsyncIterator[Bench]:
    """Inside, the units have been read for sixty periods on the disturbed line. For simulated time.

    timeout_s: None: the default one
    """
    bench = Bench(device, profile)
    bench.path = await bench.line.start()
    timeout = {} if timeout_s is None else {"timeout_s": timeout_s}
    bus = make_bus("rtu", "modbus_rtu", {"port": bench.path, **timeout})
    drivers = tuple(make_device(f"d{unit}", bus, profile, unit, {str(unit): 0}, {}, SystemClock()) for unit in UNITS)
    try:
        line = Line(bus, drivers, PERIOD_S)
        async with Acquisition([line], RealClock(), bench.readings.extend, bench.notices.append):
            await asyncio.sleep((_LEARNT_PERIODS - 0.5) * PERIOD_S)
            bench.readings.clear()
            bench.disturb(how, seed)
            await asyncio.sleep(PERIODS * PERIOD_S)
            yield bench
    finally:
        await bench.line.stop()
