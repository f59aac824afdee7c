"""The devices that `emulate` offers, each with the profile that reads it and what that needs, and one on its wire."""

import asyncio
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.base import Bus
from simulators.devices.__main__ import emulate
from simulators.devices.scenario import PlayClock, Scenario
from tests.benches.buses import make_bus

PROFILES = {
    "m7015": ("icpdas_m7015", 6),
    "pta8d08": ("eletechsup_pta8d08", 8),
    "voltage_input": ("analogue_displacement", 8),
    "adam6015": ("advantech_adam6015", 7),
    "wago464": ("wago_750_464", 4),
    "cia404": ("cia404", 4),
    "can_logger": ("", 5),
    "me_rs485": ("me_rs485", 1),
    "me_dt6120": ("me_dt6120", 1),
    "me_ethernet": ("me_ethernet", 2),
}
"""Profile and number of inputs."""


def options(device: str) -> dict[str, object]:
    if device.startswith("me_"):
        return {"range_um": 500.0}
    return {"vendor": "jumo"} if device == "cia404" else {}


def unit_of(device: str) -> int:
    return 126 if device in ("me_rs485", "me_dt6120") else 1


@asynccontextmanager
async def emulated(
    device: str, scenario: Scenario, clock: PlayClock | None = None, **more: object
) -> AsyncIterator[Bus]:
    """The bus that the device is on, and which is not connected yet; more: of its settings."""
    stop, started = asyncio.Event(), asyncio.get_running_loop().create_future()
    running = asyncio.create_task(emulate(device, scenario, unit_of(device), started.set_result, stop, clock))
    settings = tomllib.loads(f"bus = {{ {await started} }}")["bus"]
    bus = make_bus("bus", settings.pop("kind"), settings | more)
    try:
        yield bus
    finally:
        await bus.close()
        stop.set()
        await running
