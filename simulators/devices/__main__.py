"""Emulated devices on real wires, driven by a scenario: `python -m simulators.devices m7015 scenario.toml`.

Prints where it listens, as the configuration of a gateway wants it, and runs until it is interrupted.
"""

import argparse
import asyncio
import signal
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

from simulators.devices import adam6015, m7015, pta8d08, wago464
from simulators.devices.adam6015 import Adam6015
from simulators.devices.can_logger import CanLogger
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeSensor
from simulators.devices.modbus_servers import RtuLine, TcpHost
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.scenario import Scenario
from simulators.devices.slcan_adapter import SlcanAdapter
from simulators.devices.source import Faults, ValueSource
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from simulators.devices.wago_coupler import WagoCoupler

RANGE_UM = 500.0
"""Measuring range of the displacement sensors."""
_HOST = "127.0.0.1"


class RealClock:
    """Seconds of this computer."""

    def monotonic(self) -> float:
        return time.monotonic()

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(monotonic_s - time.monotonic())


Module = M7015 | Pta8d08 | VoltageInput | Adam6015 | Wago464
Started = tuple[str, Faults]
"""Bus settings to reach the device, and what breaks it."""
Start = Callable[[ValueSource, int, AsyncExitStack], Awaitable[Started]]


def _modbus(device: Callable[[ValueSource], Module], *, tcp: bool = False) -> Start:
    async def start(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
        module = device(source)
        if tcp:
            host = TcpHost({unit: WagoCoupler([module]) if isinstance(module, Wago464) else module})
            reached = f'kind = "modbus_tcp", host = "{_HOST}", port = {await host.start()}'
            stack.push_async_callback(host.stop)
        else:
            line = RtuLine({unit: module})
            reached = f'kind = "modbus_rtu", port = "{await line.start()}"'
            stack.push_async_callback(line.stop)
        return reached, module.faults

    return start


async def _node(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
    node = Cia404Node(unit, source, inputs=len(source()), heartbeat_ms=500)
    adapter = SlcanAdapter([node])
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    node.start(adapter.send)
    stack.callback(node.stop)
    return f'kind = "canopen", interface = "slcan", channel = "{path}"', node.faults


async def _logger(source: ValueSource, _: int, stack: AsyncExitStack) -> Started:
    adapter = SlcanAdapter([])
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    logger = CanLogger(source, adapter.send, cycle_s=0.1)
    logger.start()
    stack.callback(logger.stop)
    return f'kind = "can", interface = "slcan", channel = "{path}"', logger.faults


def _sensor(counted: bool) -> Start:
    async def start(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
        sensor = MeSensor(source, range_um=RANGE_UM, address=unit, payload="counted" if counted else "float")
        path = await sensor.start()
        stack.push_async_callback(sensor.stop)
        return f'kind = "me_rs485", port = "{path}"', sensor.faults

    return start


async def _controller(source: ValueSource, _: int, stack: AsyncExitStack) -> Started:
    controller = MeController(source, range_um=RANGE_UM)
    port = await controller.start()
    stack.push_async_callback(controller.stop)
    return f'kind = "me_ethernet", host = "{_HOST}", port = {port}', controller.faults


@dataclass(frozen=True, slots=True)
class Device:
    """What can be emulated."""

    start: Start
    least: int
    """Inputs; a scenario has a value for each."""
    most: int

    def check(self, name: str, scenario: Scenario) -> None:
        """Raises ValueError when the scenario has not as many values as the device can have inputs."""
        if not self.least <= scenario.channels <= self.most:
            possible = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            raise ValueError(f"`values` has {scenario.channels} entries, but {name} has {possible} inputs")


DEVICES: Mapping[str, Device] = {
    "m7015": Device(_modbus(M7015), m7015.INPUTS, m7015.INPUTS),
    "pta8d08": Device(_modbus(Pta8d08), pta8d08.INPUTS, pta8d08.INPUTS),
    "voltage_input": Device(_modbus(lambda source: VoltageInput(source, range_um=RANGE_UM)), 1, 8),
    "adam6015": Device(_modbus(Adam6015, tcp=True), adam6015.INPUTS, adam6015.INPUTS),
    "wago464": Device(_modbus(Wago464, tcp=True), wago464.INPUTS, wago464.INPUTS),
    "cia404": Device(_node, 1, 8),
    "can_logger": Device(_logger, 1, 64),
    "me_rs485": Device(_sensor(counted=False), 1, 1),
    "me_dt6120": Device(_sensor(counted=True), 1, 1),
    "me_ethernet": Device(_controller, 1, 32),
}


async def emulate(device: str, scenario: Scenario, unit: int, told: Callable[[str], None], stop: asyncio.Event) -> None:
    """Run the device until `stop`; `told` gets its bus settings. Raises ValueError for too many or too few values."""
    DEVICES[device].check(device, scenario)
    clock = RealClock()
    async with AsyncExitStack() as stack:
        settings, faults = await DEVICES[device].start(scenario.source(clock), unit, stack)
        playing = asyncio.create_task(scenario.play(faults, clock), name="scenario")
        stack.callback(playing.cancel)
        told(settings)
        await stop.wait()


async def _until_interrupted(device: str, scenario: Scenario, unit: int) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await emulate(device, scenario, unit, lambda settings: print(settings, flush=True), stop)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m simulators.devices", description=__doc__)
    parser.add_argument("device", choices=DEVICES)
    parser.add_argument("scenario", type=Path, help="TOML file: values and faults over time")
    parser.add_argument("--unit", type=int, default=1, help="unit id, node id or address (1)")
    chosen = parser.parse_args()
    try:
        scenario = Scenario.parse(chosen.scenario.read_text(encoding="utf-8"))
        DEVICES[chosen.device].check(chosen.device, scenario)
    except (OSError, ValueError) as error:
        parser.error(f"{chosen.scenario}: {error}")
    asyncio.run(_until_interrupted(chosen.device, scenario, chosen.unit))


if __name__ == "__main__":
    main()
