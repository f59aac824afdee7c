"""`python -m tests.benches.faulty_machine FOLDER EPOCH SPEED SEED HOURS PAUSE`: the bench's machine on a bad day.

One fault after the other occurs on every wire and on the control, at random with a pause of PAUSE seconds on average
between two, and each ends by itself. Prints its addresses as one JSON line when ready, and
writes what begins and ends into FOLDER/faults.jsonl; ends when its standard input closes.
"""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from datetime import datetime
from pathlib import Path

import numpy as np

from simulators.bench.machine import DEMO_TERMS, BenchMachine
from simulators.clock import SharedClock
from simulators.devices import M7015, Adam6015, Cia404Node, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.source import Faults, SensorFault
from simulators.nc import FollowingTerms, SimulatedClock
from simulators.plant import load_machine

Act = Callable[[], Awaitable[object]]
Planned = tuple[str, float, float]
"""A fault, when it begins (simulated s), and for how long."""

WIRES = {
    "a module on RTU is silent": "rtu1",
    "the TCP module is gone": "tcp1",
    "a wire is broken": "tcp1",
    "the CAN adapter is pulled out": "can1",
    "the control is off": "NC",
    "the RTU adapter is pulled out": "rtu1",
    "the displacement is out of range": "growth1",
    "the CAN node is silent": "can1",
    "the displacement's adapter is pulled out": "growth1",
    "a wire is short-circuited": "rtu1",
}
"""For each fault the bus of the configuration that it affects, or the control."""


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


@asynccontextmanager
async def breakable_machine(
    folder: Path, clock: SimulatedClock, seed: int, hours: float, terms: FollowingTerms = DEMO_TERMS
) -> AsyncIterator[tuple[BenchMachine, dict[str, int], dict[str, tuple[Act, Act]]]]:
    """The machine in this process; yields it, its TCP ports, and of each fault how it begins and ends."""
    names = load_machine().channels
    machine = BenchMachine(seed, clock, hours, terms)
    units = {u: M7015(machine.temperatures(names[6 * u - 6 : 6 * u])) for u in (1, 2, 3)}
    adam, node = Adam6015(machine.temperatures(names[18:25])), Cia404Node(5, machine.temperatures(names[25:]), inputs=4)
    host, growth = TcpHost({1: adam}), MeSensor(machine.growth(), range_um=500.0)
    line = Cable(folder / "rtu", RtuLine(units))
    adapter, eddy = Cable(folder / "can", SlcanAdapter([node])), Cable(folder / "growth", growth)
    async with AsyncExitStack() as stack:
        for cable in (line, adapter, eddy):
            await cable.plug()
            stack.push_async_callback(cable.unplug)
        tcp_port = await host.start()
        stack.push_async_callback(host.stop)
        url = await machine.control.start()
        stack.push_async_callback(machine.control.stop)
        faults: dict[str, tuple[Act, Act]] = {
            "a module on RTU is silent": silence(units[2].faults),
            "the TCP module is gone": (host.stop, lambda: host.start(tcp_port)),
            "a wire is broken": sensor(adam.faults, SensorFault.OPEN),
            "the CAN adapter is pulled out": (adapter.unplug, adapter.plug),
            "the control is off": (machine.control.stop, machine.control.start),
            "the RTU adapter is pulled out": (line.unplug, line.plug),
            "the displacement is out of range": sensor(growth.faults, SensorFault.OVER),
            "the CAN node is silent": silence(node.faults),
            "the displacement's adapter is pulled out": (eddy.unplug, eddy.plug),
            "a wire is short-circuited": sensor(units[1].faults, SensorFault.SHORT),
        }
        yield machine, {"tcp_port": tcp_port, "nc_port": int(url.rsplit(":", 1)[1].split("/")[0])}, faults


@asynccontextmanager
async def faulty_machine(
    folder: Path,
    clock: SimulatedClock,
    seed: int,
    hours: float,
    pause_s: float,
    terms: FollowingTerms = DEMO_TERMS,
) -> AsyncIterator[dict[str, int]]:
    """The machine and its bad day, in this process; yields its TCP ports."""
    async with breakable_machine(folder, clock, seed, hours, terms) as (machine, ports, faults):
        plan = _at_random(seed, list(faults), pause_s)
        day = asyncio.create_task(_bad_day(clock, machine, faults, plan, folder / "faults.jsonl"))
        try:
            yield ports
        finally:
            day.cancel()
            await asyncio.gather(day, return_exceptions=True)


async def _run(folder: Path, epoch: datetime, speed: float, seed: int, hours: float, pause_s: float) -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), stop.set)
    clock = SharedClock(folder / "clock", epoch=epoch, speed=speed)
    try:
        async with faulty_machine(folder, clock, seed, hours, pause_s) as ports:
            print(json.dumps(ports), flush=True)
            await stop.wait()
    finally:
        clock.close()


def _at_random(seed: int, names: Sequence[str], pause_s: float) -> Iterator[Planned]:
    """Inflict one fault at a time, for a sixth to two thirds of the pause between two, and never the same twice in a
    row."""
    random, due_s, last = np.random.default_rng(seed), 0.0, ""
    while True:
        due_s += pause_s / 6.0 + random.exponential(pause_s * 5.0 / 6.0)
        lasts_s = random.uniform(pause_s / 6.0, pause_s * 2.0 / 3.0)
        others = [name for name in names if name != last]
        last = others[int(random.integers(len(others)))]
        yield last, due_s, lasts_s
        due_s += lasts_s


async def _bad_day(
    clock: SimulatedClock,
    machine: BenchMachine,
    faults: Mapping[str, tuple[Act, Act]],
    plan: Iterator[Planned],
    log: Path,
) -> None:
    with log.open("w", encoding="utf-8", buffering=1) as file:
        for name, due_s, lasts_s in plan:
            begin, end = faults[name]
            await clock.sleep_until(due_s)
            machine.truth()
            file.write(json.dumps({"fault": name, "begin_s": clock.monotonic()}) + "\n")
            await begin()
            await clock.sleep_until(due_s + lasts_s)
            await end()
            file.write(json.dumps({"fault": name, "end_s": clock.monotonic()}) + "\n")


if __name__ == "__main__":
    folder_, epoch_, speed_, seed_, hours_, pause_ = sys.argv[1:]
    place_ = (Path(folder_), datetime.fromisoformat(epoch_))
    asyncio.run(_run(*place_, float(speed_), int(seed_), float(hours_), float(pause_)))
