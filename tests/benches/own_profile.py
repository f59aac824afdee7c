"""A unit on an emulated Modbus TCP host, and a driver with a profile that a test writes for it."""

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

from drivers.base import Clock, Driver
from drivers.build import make_device
from simulators.devices import TcpHost
from simulators.devices.modbus_unit import ModbusUnit
from tests.benches.buses import make_bus


@asynccontextmanager
async def by_own_profile(
    unit: ModbusUnit, folder: Path, profile: str, channels: Mapping[str, int], clock: Clock
) -> AsyncIterator[Driver]:
    """The unit's driver, connected.

    Parameters
    ----------
    folder: gets the profile
    profile: its text
    """
    path = folder / "own.toml"
    path.write_text(profile, encoding="utf-8")
    host = TcpHost({1: unit})
    bus = make_bus("tcp1", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
    driver = make_device("module", bus, str(path), 1, channels, {}, clock)
    try:
        await bus.connect()
        await driver.connect()
        yield driver
    finally:
        await bus.close()
        await host.stop()
