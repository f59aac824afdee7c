"""Emulated devices on real wires, driven by a scenario: `python -m simulators.devices m7015 scenario.toml`.

Given the path of a Modbus profile (`meter.toml`) instead of a device's name, it emulates a unit as that profile
describes it. Prints its address in the form of a gateway's configuration, and runs until it is interrupted.
"""

import argparse
import asyncio
import signal
import time
import tomllib
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from simulators.devices import adam6015, m7015, pta8d08, wago464
from simulators.devices.adam6015 import Adam6015
from simulators.devices.can_logger import CanLogger
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_controller import MeController
from simulators.devices.me_sensor import MeLine, MeSensor
from simulators.devices.modbus_servers import RtuLine, TcpHost
from simulators.devices.profiled_unit import ProfiledUnit, blocks_of, channels_of
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.scenario import NotOfThisDeviceError, PlayClock, Scenario
from simulators.devices.slcan_adapter import SlcanAdapter
from simulators.devices.source import Actions, ValueSource
from simulators.devices.voltage_input import VoltageInput
from simulators.devices.wago464 import Wago464
from simulators.devices.wago_coupler import WagoCoupler
from simulators.devices.wire_faults import CAN, CANOPEN, ME_LINE, ME_STREAM, RTU, TCP, WireFaults

RANGE_UM = 500.0
"""Measuring range of the displacement sensors."""
_HOST = "127.0.0.1"


class ComputerClock:
    """Seconds of this computer."""

    def monotonic(self) -> float:
        return time.monotonic()

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(monotonic_s - time.monotonic())


Module = M7015 | Pta8d08 | VoltageInput | Adam6015 | Wago464 | ProfiledUnit
Started = tuple[str, Actions]
"""Bus settings for reaching the device, and what a scenario can do to it."""
Start = Callable[[ValueSource, int, AsyncExitStack], Awaitable[Started]]


def _modbus(device: Callable[[ValueSource], Module], *, tcp: bool = False) -> Start:
    async def start(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
        module, wire = device(source), WireFaults(TCP if tcp else RTU)
        answers = WagoCoupler([module]) if isinstance(module, Wago464) else module
        place = TcpHost({unit: answers}) if tcp else RtuLine({unit: answers})
        place.spoil = wire.spoil
        where = await place.start()
        stack.push_async_callback(place.stop)
        actions = module.faults.actions() | wire.actions()
        if isinstance(module, M7015 | Adam6015):
            set_type_code = module.set_type_code
            actions["type_code"] = lambda told: set_type_code(*told)
        if tcp:
            return f'kind = "modbus_tcp", host = "{_HOST}", port = {where}', actions
        return f'kind = "modbus_rtu", port = "{where}"', actions

    return start


async def _node(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
    node, wire = Cia404Node(unit, source, inputs=len(source()), heartbeat_ms=500), WireFaults(CANOPEN)
    adapter = SlcanAdapter([node])
    adapter.spoil = wire.spoil
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    node.start(adapter.send)
    stack.callback(node.stop)
    actions = node.faults.actions() | wire.actions()
    actions["type_code"] = lambda told: node.set_sensor_type(*told)
    actions["heartbeat"] = lambda on: setattr(node, "heartbeat_stopped", not on)
    actions["emcy"] = lambda code: adapter.send(node.emergency(code))
    actions["reboot"] = lambda _: adapter.send(node.reboot())
    return f'kind = "canopen", interface = "slcan", channel = "{path}"', actions


async def _logger(source: ValueSource, _: int, stack: AsyncExitStack) -> Started:
    adapter, wire = SlcanAdapter([]), WireFaults(CAN)
    adapter.spoil = wire.spoil
    path = await adapter.start()
    stack.push_async_callback(adapter.stop)
    logger = CanLogger(source, adapter.send, cycle_s=0.1)
    logger.start()
    stack.callback(logger.stop)
    return f'kind = "can", interface = "slcan", channel = "{path}"', logger.faults.actions() | wire.actions()


def _sensor(counted: bool) -> Start:
    async def start(source: ValueSource, unit: int, stack: AsyncExitStack) -> Started:
        sensor = MeSensor(source, range_um=RANGE_UM, address=unit, payload="counted" if counted else "float")
        line, wire = MeLine([sensor]), WireFaults(ME_LINE)
        line.spoil = wire.spoil
        path = await line.start()
        stack.push_async_callback(line.stop)
        return f'kind = "me_rs485", port = "{path}"', sensor.faults.actions() | wire.actions()

    return start


async def _controller(source: ValueSource, _: int, stack: AsyncExitStack) -> Started:
    controller, wire = MeController(source, range_um=RANGE_UM), WireFaults(ME_STREAM)
    controller.spoil = wire.spoil
    port = await controller.start()
    stack.push_async_callback(controller.stop)
    actions = controller.faults.actions() | wire.actions()
    return f'kind = "me_ethernet", host = "{_HOST}", port = {port}', actions


@dataclass(frozen=True, slots=True)
class EmulatedDevice:
    """What can be emulated."""

    start: Start
    least: int
    """Number of inputs; a scenario has a value for each."""
    most: int

    def check(self, name: str, scenario: Scenario) -> None:
        """Raises ValueError if the number of the scenario's values cannot be the device's number of inputs."""
        if not self.least <= scenario.channels <= self.most:
            possible = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            raise ValueError(f"`values` has {scenario.channels} entries, but {name} has {possible} inputs")


DEVICES: Mapping[str, EmulatedDevice] = {
    "m7015": EmulatedDevice(_modbus(M7015), m7015.INPUTS, m7015.INPUTS),
    "pta8d08": EmulatedDevice(_modbus(Pta8d08), pta8d08.INPUTS, pta8d08.INPUTS),
    "voltage_input": EmulatedDevice(_modbus(lambda source: VoltageInput(source, range_um=RANGE_UM)), 1, 8),
    "adam6015": EmulatedDevice(_modbus(Adam6015, tcp=True), adam6015.INPUTS, adam6015.INPUTS),
    "wago464": EmulatedDevice(_modbus(Wago464, tcp=True), wago464.INPUTS, wago464.INPUTS),
    "cia404": EmulatedDevice(_node, 1, 8),
    "can_logger": EmulatedDevice(_logger, 1, 64),
    "me_rs485": EmulatedDevice(_sensor(counted=False), 1, 1),
    "me_dt6120": EmulatedDevice(_sensor(counted=True), 1, 1),
    "me_ethernet": EmulatedDevice(_controller, 1, 32),
}


def device_of(name: str) -> EmulatedDevice:
    """The device of that name, or as the Modbus profile at that path describes it. Raises ValueError or OSError."""
    if name in DEVICES:
        return DEVICES[name]
    if not name.endswith(".toml"):
        raise ValueError(f"{name!r} is unknown: expected a path of a Modbus profile, or one of {', '.join(DEVICES)}")
    profile = tomllib.loads(Path(name).read_text(encoding="utf-8"))
    try:
        inputs = sum(map(channels_of, blocks_of(profile)))
        tcp = profile["buses"] == ["modbus_tcp"]
    except KeyError as error:
        raise ValueError(f"{name}: not a Modbus profile: {error} is missing") from error
    return EmulatedDevice(_modbus(partial(ProfiledUnit, profile), tcp=tcp), inputs, inputs)


async def emulate(
    device: str,
    scenario: Scenario,
    unit: int,
    told: Callable[[str], None],
    stop: asyncio.Event,
    clock: PlayClock | None = None,
) -> None:
    """Run the device until `stop`; `told` is called with its bus settings.

    clock: the time in which the scenario is played; None: the computer's

    device: a name in DEVICES, or the path of a Modbus profile

    Raises ValueError for too many or too few values, NotOfThisDeviceError for an event that this device cannot have.
    """
    emulated = device_of(device)
    emulated.check(device, scenario)
    clock = clock or ComputerClock()
    async with AsyncExitStack() as stack:
        settings, actions = await emulated.start(scenario.source(clock), unit, stack)
        scenario.check(device, actions)
        playing = asyncio.create_task(scenario.play(actions, clock), name="scenario")
        stack.callback(playing.cancel)
        told(settings)
        await stop.wait()


async def _until_interrupted(device: str, scenario: Scenario, unit: int) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await emulate(device, scenario, unit, lambda settings: print(_section(settings), flush=True), stop)


def _section(settings: str) -> str:
    return "\n".join(("[[bus]]", 'name = "bus1"', *settings.split(", ")))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m simulators.devices", description=__doc__)
    parser.add_argument("device", help=f"{', '.join(DEVICES)}, or the path of a Modbus profile (.toml)")
    parser.add_argument("scenario", type=Path, help="TOML file: values and faults over time")
    parser.add_argument("--unit", type=int, default=1, help="unit id, node id or address (1)")
    chosen = parser.parse_args()
    try:
        device = device_of(chosen.device)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    try:
        scenario = Scenario.parse(chosen.scenario.read_text(encoding="utf-8"))
        device.check(chosen.device, scenario)
    except (OSError, ValueError) as error:
        parser.error(f"{chosen.scenario}: {error}")
    try:
        asyncio.run(_until_interrupted(chosen.device, scenario, chosen.unit))
    except NotOfThisDeviceError as error:
        parser.error(f"{chosen.scenario}: {error}")


if __name__ == "__main__":
    main()
