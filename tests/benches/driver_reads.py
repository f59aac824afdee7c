"""Reads a driver until it fails, and gives its readings in the form in which tests expect them."""

import asyncio
from collections.abc import Sequence

from drivers.base import Driver, Quality, Reading


async def read_until_error(driver: Driver) -> None:
    """Raises the error; what came before the fault may still be fresh."""
    async with asyncio.timeout(60.0):
        while True:
            await driver.read()
            await asyncio.sleep(0.005)


def told(readings: Sequence[Reading]) -> list[tuple[float | str, str]]:
    """Each channel in the form that tests expect: value and unit if it is good, otherwise quality and reason."""
    return [(r.value, r.unit) if r.quality is Quality.GOOD else (r.quality.value, r.detail) for r in readings]


def values_or_reasons(readings: Sequence[Reading]) -> list[float | str]:
    """The value of good channels, quality and reason of others in one text."""
    return [r.value if r.quality is Quality.GOOD else f"{r.quality.value}: {r.detail}" for r in readings]
