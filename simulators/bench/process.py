"""The emulated machine as a process: starts everything, prints the addresses, and ends when its parent has ended."""

import asyncio
import json
import signal
import sys
from contextlib import AsyncExitStack
from datetime import datetime
from pathlib import Path

from simulators.bench.machine import DEMO_TERMS, BenchMachine, TruthRecorder
from simulators.clock import SharedClock
from simulators.devices import M7015, Adam6015, Cia404Node, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.plant import load_machine

GROWTH_RANGE_UM = 500.0
"""The eddy-current sensor's measuring range; as in gateway.toml."""
CAN_NODE = 5
_SENSORS = load_machine().channels
_RTU, _TCP, _CAN = _SENSORS[:18], _SENSORS[18:25], _SENSORS[25:]
"""As wired in gateway.toml."""


async def _start(machine: BenchMachine, stack: AsyncExitStack) -> dict[str, str | int]:
    """Start every device and the control; returns their addresses under the names that gateway.toml uses."""
    units = {unit: M7015(machine.temperatures(_RTU[6 * (unit - 1) : 6 * unit])) for unit in (1, 2, 3)}
    line = RtuLine(units)
    host = TcpHost({1: Adam6015(machine.temperatures(_TCP))})
    adapter = SlcanAdapter([Cia404Node(CAN_NODE, machine.temperatures(_CAN), inputs=len(_CAN))])
    sensor = MeSensor(machine.growth(), range_um=GROWTH_RANGE_UM)
    addresses: dict[str, str | int] = {"rtu_port": await line.start()}
    stack.push_async_callback(line.stop)
    addresses["tcp_port"] = await host.start()
    stack.push_async_callback(host.stop)
    addresses["can_port"] = await adapter.start()
    stack.push_async_callback(adapter.stop)
    addresses["growth_port"] = await sensor.start()
    stack.push_async_callback(sensor.stop)
    url = await machine.control.start()
    stack.push_async_callback(machine.control.stop)
    addresses["nc_port"] = int(url.rsplit(":", 1)[1].split("/")[0])
    return addresses


async def _run(
    folder: Path, epoch: datetime, speed: float, seed: int, hours: float, *, follows: bool, rests: bool
) -> None:
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    # Standard input closes when the parent ends, however it ends, so no machine stays behind.
    loop.add_reader(sys.stdin.fileno(), stop.set)
    clock = SharedClock(folder / "clock", epoch=epoch, speed=speed)
    async with AsyncExitStack() as stack:
        stack.callback(clock.close)
        machine = BenchMachine(seed, clock, hours, DEMO_TERMS if follows else None, rests=rests)
        print(json.dumps(await _start(machine, stack)), flush=True)
        recorder = asyncio.create_task(TruthRecorder(machine, clock, folder / "truth.csv").run(stop.is_set))
        waiting = asyncio.create_task(stop.wait())
        await asyncio.wait([recorder, waiting], return_when=asyncio.FIRST_COMPLETED)
        for task in (recorder, waiting):
            task.cancel()
        results = await asyncio.gather(recorder, waiting, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception):
                raise result


def main() -> None:
    """`python -m simulators.bench FOLDER EPOCH SPEED SEED HOURS [k0] [rests]`: prints its addresses as JSON when ready.

    k0: its control has no program that follows the nine errors; routes that write K0 belong to it.
    rests: its program stops every five minutes for three.
    """
    folder, epoch, speed, seed, hours, *words = sys.argv[1:]
    begins, pace = datetime.fromisoformat(epoch), float(speed)
    kind = {"follows": "k0" not in words, "rests": "rests" in words}
    asyncio.run(_run(Path(folder), begins, pace, int(seed), float(hours), **kind))
