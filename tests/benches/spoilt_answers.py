"""Changes what devices answer, by a seed, and reads them."""

import asyncio
import random
from collections.abc import Iterable, Sequence
from contextlib import suppress
from math import isfinite

from drivers.base import Bus, Driver, DriverError, Quality, Reading
from tests.benches.buses import make_bus
from tests.benches.rigs import Rig

_LATEST_S = 0.3
"""The latest time of a late answer."""
_BETWEEN_S = 0.1
"""The pause for devices that send by themselves."""

Sent = Sequence[tuple[float, bytes]]
"""When, in seconds from now, and what."""


class Spoiler:
    """Changes, cuts, doubles, delays and exchanges answers, by a seed."""

    def __init__(self, seed: int) -> None:
        self._draw = random.Random(seed)
        self._before = b""
        self.answers = 0

    def __call__(self, _: int, data: bytes) -> Sent:  # noqa: C901 - one arm for each way to spoil
        draw, before, self._before = self._draw, self._before, data
        self.answers += 1
        spoilt, at = bytearray(data), draw.randrange(len(data) + 1)
        match draw.choice(("bytes", "ones", "cut", "head", "double", "noise", "before", "late", "none", "whole")):
            case "bytes":
                for _ in range(draw.randint(1, 4)):
                    spoilt[draw.randrange(len(data))] = draw.randrange(256)
            case "ones":
                spoilt[at : at + 4] = b"\xff" * len(spoilt[at : at + 4])
            case "cut":
                del spoilt[at:]
            case "head":
                del spoilt[:at]
            case "double":
                spoilt += data
            case "noise":
                spoilt[at:at] = draw.randbytes(draw.randint(1, 300))
            case "before":
                return [(0.0, before), (0.0, data)]
            case "late":
                return [(draw.random() * _LATEST_S, data)]
            case "none":
                return []
            case _:
                pass
        return [(0.0, bytes(spoilt))]


def whole(readings: Sequence[Reading], channels: Sequence[str]) -> bool:
    """What the interface promises of every read."""
    return [reading.channel for reading in readings] == list(channels) and all(
        isfinite(reading.value) or not reading.quality.usable for reading in readings
    )


async def connected(bus: Bus, driver: Driver) -> None:
    await driver.close()
    await bus.close()
    await bus.connect()
    await driver.connect()


async def until_good(bus: Bus, driver: Driver) -> Sequence[Reading]:
    said: object = None
    for _ in range(20):
        try:
            readings = await driver.read()
            if {reading.quality for reading in readings} == {Quality.GOOD}:
                return readings
            said = readings
        except DriverError as error:
            said = error
        with suppress(DriverError):
            await connected(bus, driver)
    raise AssertionError(f"no good reading after twenty attempts: {said!r}")


async def read_spoilt(rig: Rig, seeds: Iterable[int]) -> int:
    """Read through spoilt answers of each seed, then well. Returns how many answers were spoilt.

    Raises AssertionError for a reading that is not whole or not true, and whatever is not a DriverError.
    """
    bus = make_bus("bus1", rig.kind, rig.options)
    driver = rig.make(bus)
    spoilt = 0
    try:
        for seed in seeds:
            rig.wire.spoil = None
            await until_good(bus, driver)
            rig.wire.spoil = spoiler = Spoiler(seed)
            for number in range(8):
                await asyncio.sleep(_BETWEEN_S)
                with suppress(DriverError):
                    if number % 4 == 3:
                        await connected(bus, driver)
                    assert whole(await driver.read(), driver.channels)
            spoilt += spoiler.answers
        rig.wire.spoil = None
        await asyncio.sleep(
            _LATEST_S + rig.settle_s
        )  # a spoilt frame without a checksum is the latest until the next one
        readings = await until_good(bus, driver)
        far = [r.value - true for r, true in zip(readings, rig.true_values, strict=True)]
        assert max(map(abs, far)) <= rig.tolerance * 1.0001 + 1e-9
    finally:
        await driver.close()
        await bus.close()
    return spoilt
