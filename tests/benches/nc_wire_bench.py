"""The link at work on an emulated control, over its real protocol and a connection that can be cut."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from drivers.nc import WatchdogTerms
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.config.extended import validate
from gateway.model.compensation import Write
from gateway.model.notice import Notice
from gateway.model.probing import Outcome
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MachineState, MeanLoads, User
from talc.frame import Decision, Phase, Why
from tests.benches.cut_wire import CutWire, wire_to
from tests.benches.emulated_bench import Rigid
from tests.benches.wire_clock import WireClock

SLEW_UM_PER_S = 1.0
CYCLE = CycleSettings(noise_um=0.0)


class LineControl(EmulatedControl):
    """An emulated control that the tests can spoil."""

    frozen: MachineState | None = None
    """Shown instead of the machine's real state."""
    clock_wrong_by = timedelta()
    looks = 0

    def state(self) -> MachineState:
        self.looks += 1
        now = super().state()
        return now if self.frozen is None else self.frozen

    def utc(self) -> datetime:
        return super().utc() + self.clock_wrong_by


@dataclass
class NcWireBench:
    """A link at work, over a connection that can be cut."""

    clock: WireClock
    control: LineControl
    link: NcLink
    wire: CutWire
    notices: list[Notice] = field(default_factory=list)
    steps: list[Write] = field(default_factory=list)

    def told(self, ended: bool) -> list[str]:
        return [notice.text for notice in self.notices if notice.ended is ended]

    async def measured(self, until_s: float, why: Why = Why.INTERVAL) -> Outcome:
        """The result of a measurement that begins now and has ended by then."""
        cycle = asyncio.create_task(self.link.measure(why))
        await self.clock.run_until(until_s)
        return await cycle

    async def ended(self, cycle: asyncio.Task[Outcome], within_s: float) -> Outcome:
        """The result of a measurement. Raises AssertionError if it has not ended within this simulated time."""
        end_s = self.clock.monotonic() + within_s
        while not cycle.done():
            assert self.clock.monotonic() < end_s, self.control.nck.cycle.answer
            await self.clock.run_until(self.clock.monotonic() + 5.0)
        return cycle.result()

    def shift(self) -> np.ndarray:
        return np.array(self.control.nck.shift_um((0.0, 0.0, 0.0)))

    def jumps_um(self) -> float:
        """Largest change of SD43900 between two changes of it."""
        values = np.array([(0.0, 0.0, 0.0), *(entry.values_mm for entry in self.control.nck.log)]) * 1e3
        return float(np.abs(np.diff(values, axis=0)).max())

    def written_meanwhile(self) -> list[float]:
        """When offsets changed while the control probed, by its own record."""
        nck = self.control.nck
        return [entry.time_s for entry in nck.log for a, b in nck.cycle.ended if a < entry.time_s < b]


def wants(z_um: float) -> Decision:
    errors = np.zeros(9)
    errors[1] = z_um  # EZ0A: at A = 0 the offset in Z
    return Decision(1, Phase.COMPENSATION, errors, errors, np.full(9, math.nan), np.full(9, math.nan), None, None, ())


@asynccontextmanager
async def bench(
    *, mode: str = "compensate", start: bool = True, users: dict[str, User] | None = None, password: Path | None = None,
    subscribe_s: float = 0.0, owner: int = 1,
) -> AsyncIterator[NcWireBench]:  # fmt: skip
    clock = WireClock()
    loads = MeanLoads(x=60.0, spindle=3000.0)
    control = LineControl(
        Rigid(), clock, LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, loads)]), cycle=CYCLE, users=users
    )
    async with AsyncExitStack() as stack:
        url = await control.start()
        stack.push_async_callback(asyncio.get_running_loop().shutdown_default_executor)
        stack.push_async_callback(control.stop)
        if not start:
            await control.stop()
        wire, joined = await stack.enter_async_context(wire_to(url))
        user = None if password is None else "gateway"
        settings = SinumerikSettings(
            security="none", url=joined, timeout_s=1.0, user=user, password_file=password, subscribe_s=subscribe_s
        )
        config = validate(
            {
                "machine": {"name": "mill"},
                "nc": {"kind": "sinumerik", "url": joined, "security": "none"},
                "probing": {"armed": True, "timeout_s": 300.0, "reference_cycles": 1},
                "compensation": {"mode": mode, "slew_um_per_s": SLEW_UM_PER_S, "stale_after_s": 5000.0},
            }
        )
        nc = Sinumerik(settings, clock)
        found = NcWireBench(clock, control, None, wire)  # type: ignore[arg-type]  # made with its callbacks
        found.link = NcLink(
            nc,
            clock,
            LinkSettings.of(config, Identity(owner)),
            Earlier(first_number=41),
            Listeners(written=found.steps.append, notify=found.notices.append),
        )
        task = asyncio.create_task(found.link.run())
        try:
            yield found
        finally:
            died = task.done()
            task.cancel()
            [error] = await asyncio.gather(task, return_exceptions=True)
            await nc.close()
            assert not died, error


@asynccontextmanager
async def driver_of_the_other(at: NcWireBench) -> AsyncIterator[Sinumerik]:
    """A second gateway's connection, beside the one that the first gateway uses; it has claimed the control."""
    other = Sinumerik(SinumerikSettings(security="none", url=f"opc.tcp://127.0.0.1:{at.wire.target}"), at.clock)
    await other.connect()
    await other.claim(1, WatchdogTerms(60.0, 1.0))
    try:
        yield other
    finally:
        await other.close()
