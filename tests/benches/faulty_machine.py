"""`python -m tests.benches.faulty_machine FOLDER EPOCH SPEED SEED HOURS`: the bench's machine on a bad day.

One fault after the other on every wire and on the control, each mended by nobody but time. Prints its addresses as one
JSON line when ready; ends when its standard input closes.
"""

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from datetime import datetime
from itertools import cycle
from pathlib import Path

from simulators.bench.machine import BenchMachine
from simulators.clock import SharedClock
from simulators.devices import M7015, Adam6015, Cia404Node, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.source import Faults, SensorFault
from simulators.plant import load

FAULT_EVERY_S = 1200.0
FAULT_LASTS_S = 480.0

Act = Callable[[], Awaitable[object]]


class Cable:
    """A serial device whose adapter is pulled out and put back: a new terminal each time, under one name."""

    def __init__(self, link: Path, device: RtuLine | SlcanAdapter | MeSensor) -> None:
        self._link, self._device = link, device

    async def plug(self) -> None:
        self._link.symlink_to(await self._device.start())

    async def unplug(self) -> None:
        self._link.unlink(missing_ok=True)
        await self._device.stop()


def sensor(faults: Faults, fault: SensorFault) -> tuple[Act, Act]:
    return _now(lambda: faults.set(0, fault)), _now(lambda: faults.set(0, None))


def silence(faults: Faults) -> tuple[Act, Act]:
    return _now(lambda: setattr(faults, "silent", True)), _now(lambda: setattr(faults, "silent", False))


def _now(act: Callable[[], None]) -> Act:
    async def later() -> None:
        act()

    return later


async def _run(folder: Path, epoch: datetime, speed: float, seed: int, hours: float) -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), stop.set)
    names = load().channels
    clock = SharedClock(folder / "clock", epoch=epoch, speed=speed)
    machine = BenchMachine(seed, clock, hours)
    units = {u: M7015(machine.temperatures(names[6 * u - 6 : 6 * u])) for u in (1, 2, 3)}
    adam, node = Adam6015(machine.temperatures(names[18:25])), Cia404Node(5, machine.temperatures(names[25:]), inputs=4)
    host, growth = TcpHost({1: adam}), MeSensor(machine.growth(), range_um=500.0)
    line = Cable(folder / "rtu", RtuLine(units))
    adapter, eddy = Cable(folder / "can", SlcanAdapter([node])), Cable(folder / "growth", growth)
    async with AsyncExitStack() as stack:
        stack.callback(clock.close)
        for cable in (line, adapter, eddy):
            await cable.plug()
            stack.push_async_callback(cable.unplug)
        tcp_port = await host.start()
        stack.push_async_callback(host.stop)
        url = await machine.control.start()
        stack.push_async_callback(machine.control.stop)
        faults: list[tuple[Act, Act]] = [
            silence(units[2].faults),
            (host.stop, lambda: host.start(tcp_port)),
            sensor(adam.faults, SensorFault.OPEN),
            (adapter.unplug, adapter.plug),
            (machine.control.stop, machine.control.start),
            (line.unplug, line.plug),
            sensor(growth.faults, SensorFault.OVER),
            silence(node.faults),
            (eddy.unplug, eddy.plug),
            sensor(units[1].faults, SensorFault.SHORT),
        ]
        ports = {"tcp_port": tcp_port, "nc_port": int(url.rsplit(":", 1)[1].split("/")[0])}
        print(json.dumps(ports), flush=True)
        day = asyncio.create_task(_bad_day(clock, machine, faults))
        await stop.wait()
        day.cancel()
        await asyncio.gather(day, return_exceptions=True)


async def _bad_day(clock: SharedClock, machine: BenchMachine, faults: list[tuple[Act, Act]]) -> None:
    due = FAULT_EVERY_S
    for begin, end in cycle(faults):
        await clock.sleep_until(due)
        machine.truth()
        await begin()
        await clock.sleep_until(due + FAULT_LASTS_S)
        await end()
        due += FAULT_EVERY_S


if __name__ == "__main__":
    folder_, epoch_, speed_, seed_, hours_ = sys.argv[1:6]
    asyncio.run(_run(Path(folder_), datetime.fromisoformat(epoch_), float(speed_), int(seed_), float(hours_)))
