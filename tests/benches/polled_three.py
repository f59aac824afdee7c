"""Three units on one line, polled as by a gateway whose configuration states only what it must."""

from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import numpy as np

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.config.file import load
from gateway.runtime.clocks import RealClock
from simulators.devices import DeviceServer, RtuLine, TcpHost
from simulators.devices.modbus_unit import ModbusUnit

UNITS = (1, 2, 3)
PERIOD_S, TIMEOUT_S = 1.0, 0.5
"""The defaults."""
BAUD = 9600
"""The default of a serial line; its emulator takes as long as its bytes would."""
MODBUS = ("modbus_rtu", "modbus_rtu_tcp", "modbus_tcp")

PolledLine = RtuLine | DeviceServer | TcpHost


async def started_line(
    kind: str, units: Mapping[int, ModbusUnit], stack: AsyncExitStack
) -> tuple[PolledLine, Mapping[str, object]]:
    """The line, and the fields by which a configuration finds it."""
    line: PolledLine
    if kind == "modbus_rtu":
        line, fields = RtuLine(units, baud=BAUD), {"kind": kind}
    else:
        line, fields = (TcpHost if kind == "modbus_tcp" else DeviceServer)(units), {"kind": kind, "host": "127.0.0.1"}
    stack.push_async_callback(line.stop)
    return line, {**fields, "port": await line.start()}


@asynccontextmanager
async def polled(
    bus: Mapping[str, object], device: str, channels: str, folder: Path, readings: list[Reading]
) -> AsyncIterator[None]:
    """Inside, the gateway polls the three.

    Parameters
    ----------
    bus: fields of its section
    device: TOML of a device's section, without its name, its bus and its unit
    channels: their table, with `UNIT` for the number of the unit
    folder: gets the configuration
    readings: gets what is read
    """
    head = "\n".join(f"{key} = {value!r}" for key, value in bus.items())
    devices = "".join(
        f'[[device]]\nname = "d{unit}"\nbus = "wire"\nunit = {unit}\n{device}\n'
        f"channels = {channels.replace('UNIT', str(unit))}\n"
        for unit in UNITS
    )
    file = folder / "gateway.toml"
    file.write_text(f'[machine]\nname = "mill"\n[[bus]]\nname = "wire"\n{head}\n{devices}')
    clock = RealClock()
    (line,) = lines_of(load(file), clock)
    assert (line.period_s, line.bus.timeout_s) == (PERIOD_S, TIMEOUT_S), "the defaults"
    async with Acquisition([line], clock, readings.extend, lambda _: None):
        yield


def worst(readings: list[Reading], channel: str, since_s: float = 0.0) -> float:
    """The largest difference of the channel's intervals from the period, as a share; checks that its readings are
    good."""
    own = [r for r in readings if r.channel == channel and r.monotonic_s >= since_s]
    assert {r.quality for r in own} == {Quality.GOOD}
    return float(np.abs(np.diff([r.monotonic_s for r in own]) / PERIOD_S - 1.0).max())
