"""Reads the devices of a line once: `probe` and `scan` show the values that `run` would take."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

from drivers.base import Reading
from gateway.acquisition.line import Line
from gateway.acquisition.runner import BusRunner
from gateway.runtime.clocks import ServiceClock

_APART_S = 0.25
"""Between such readings."""


@dataclass(frozen=True, slots=True)
class DeviceAnswer:
    """The answer of one device."""

    device: str
    readings: tuple[Reading, ...]
    """One per channel; comm_fault if it did not answer, with the reason in the detail."""
    took_s: float | None
    """Answer time without connecting; None: no answer."""
    error: Exception | None
    """Why it did not answer; None also if its bus could not be opened."""


async def read_once(
    line: Line, clock: ServiceClock, *, keep_open: bool = False, learns: bool = False
) -> list[DeviceAnswer]:
    """Read every device of the line, one after the other. Errors of a bus or device are not raised.

    keep_open: the bus was open and is to stay open, as far as the devices allow
    learns: read them several times if one cannot be read though something is heard, or might be soon, so that the bus
        finds out why
    """
    readings: dict[str, Reading] = {}

    def take(some: Sequence[Reading]) -> None:
        readings.update((reading.channel, reading) for reading in some)

    began_s = clock.monotonic()
    runner = BusRunner(line, clock, take, lambda _: None, count(1).__next__, quiet=True)
    try:
        await runner.once()
        while learns and runner.may_learn(began_s):
            await asyncio.sleep(_APART_S)
            await runner.once()
    finally:
        if keep_open:
            await runner.close_devices()
        else:
            await runner.close()
    return [
        DeviceAnswer(
            device.driver.device,
            tuple(readings[channel] for channel in device.driver.channels),
            device.answered_s,
            device.error,
        )
        for device in runner.devices
    ]
