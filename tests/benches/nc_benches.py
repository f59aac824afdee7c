"""The ways to a numerical control, with the actions of the contract's tests on each.

The real LinuxCNC passes the clauses of its agent (tests/gateway/commissioning/agent_test), and another maker's OPC UA
server has its own tests.

Another implementation joins by a class that derives from NcBench and an entry in BENCHES.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

from drivers.agent.control import AgentControl
from drivers.agent.settings import AgentSettings
from drivers.base import SystemClock
from drivers.nc import NumericalControl, ProbingState, RequestStatus, WatchdogTerms
from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.settings import OffsetRoute, SinumerikSettings
from simulators.nc import FollowingTerms, Nck
from tests.benches.emulated_bench import DayPlant, day, sinumerik_bench, wired
from tests.benches.in_process_nc import InProcess
from tests.benches.manual_clock import ManualClock
from tests.benches.reference_agent import ServedAgent, served_agent, workshop_machine

_NO_SAFE_POINT_S = 10.0
"""Well within an operation of the emulated control's program."""
FINAL = (ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED)


class NcBench(ABC):
    """A control on the bench and the driver under test, connected; no gateway has claimed it."""

    nc: NumericalControl
    working: Mapping[str, float]
    """Machine states after `work`."""
    tick_s = 0.05
    """The control's time between two looks."""

    @abstractmethod
    def another(self) -> NumericalControl:
        """A second gateway's driver for the same control, not connected."""

    @abstractmethod
    async def wait(self, seconds: float) -> None:
        """Let the control's time pass."""

    @abstractmethod
    async def work(self) -> None:
        """Have the machine cut: spindle and cutting fluid on, a tool that is no probe."""

    @abstractmethod
    async def stop(self) -> None:
        """An emergency stop, or what this control has instead."""

    @abstractmethod
    async def switch_on(self) -> None:
        """After `stop`: ready again."""

    @abstractmethod
    async def allow_probing(self) -> None:
        """From now on the control reaches a safe point."""

    async def ends(self, number: int, limit_s: float = 300.0) -> RequestStatus:
        """The final status of a cycle."""
        return await self.reaches(number, *FINAL, limit_s=limit_s)

    async def reaches(self, number: int, *states: ProbingState, limit_s: float = 300.0) -> RequestStatus:
        """The first status in one of these states."""
        for _ in range(round(limit_s / self.tick_s)):
            status = await self.nc.probing_status(number)
            if status.state in states:
                return status
            await self.wait(self.tick_s)
        raise AssertionError(f"cycle {number} is {status.state} after {limit_s} s, expected {states}")

    async def alive(self, owner: int, terms: WatchdogTerms) -> None:
        """Claim the control and beat until its watchdog watches."""
        await self.nc.claim(owner, terms)
        await self.until(lambda: self.nc.heartbeat(owner))

    async def until(self, condition: Callable[[], Awaitable[bool]]) -> None:
        """Let the control's time pass until a condition holds; fails after a minute of the computer's time."""
        async with asyncio.timeout(60.0):
            while not await condition():
                await self.wait(self.tick_s)


class EmulatedBench(NcBench):
    """The emulated control, whatever speaks to it."""

    tick_s = 5.0

    def __init__(self, nck: Nck, clock: ManualClock, driver: Callable[[], NumericalControl]) -> None:
        self._nck, self._clock, self._driver = nck, clock, driver
        self.working = {"spindle_speed": 6000.0, "coolant": 1.0, "speed_X": 1200.0, "speed_C": 30.0}
        self.nc = driver()

    def another(self) -> NumericalControl:
        return self._driver()

    async def wait(self, seconds: float) -> None:
        self._clock.move_to(self._clock.now + seconds)
        await asyncio.sleep(0)

    async def work(self) -> None:
        await self.wait(30.0)

    async def stop(self) -> None:
        self._nck.raise_alarm(3000, self._clock.now)

    async def switch_on(self) -> None:
        self._nck.clear_alarms(self._clock.now)

    async def allow_probing(self) -> None:
        """Nothing to do: the safe point comes by itself, at the end of an operation."""


class ReferenceAgentBench(NcBench):
    """The agent of examples/agent, on the test's time."""

    def __init__(self, served: ServedAgent, settings: AgentSettings) -> None:
        self._machine, self._settings = served.machine, settings
        self.working = {"spindle_speed": 1200.0, "coolant": 1.0}
        self.nc = self.another()

    def another(self) -> NumericalControl:
        return AgentControl(self._settings, SystemClock())

    async def wait(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def work(self) -> None:
        self._machine.told["states"].update(self.working)

    async def stop(self) -> None:
        self._machine.stop()

    async def switch_on(self) -> None:
        self._machine.told["estop"] = False

    async def allow_probing(self) -> None:
        self._machine.safe = True


Opened = AbstractAsyncContextManager[NcBench]


@asynccontextmanager
async def in_process(_: Path) -> AsyncIterator[NcBench]:
    clock = ManualClock()
    nck = Nck(DayPlant(), day())
    bench = EmulatedBench(nck, clock, lambda: InProcess(nck, clock))
    await bench.nc.connect()
    await bench.wait(_NO_SAFE_POINT_S)
    yield bench


def sinumerik(compensation: OffsetRoute, subscribe_s: float = 0.0) -> Callable[[Path], Opened]:
    @asynccontextmanager
    async def opened(_: Path) -> AsyncIterator[NcBench]:
        errors = FOLLOWING if compensation.route == "errors" else None
        async with sinumerik_bench(errors=errors) as inner:
            settings = wired(SinumerikSettings(security="none", url=inner.url)).model_copy(
                update={"compensation": compensation, "subscribe_s": subscribe_s}
            )
            bench = EmulatedBench(inner.control.nck, inner.clock, lambda: make_sinumerik(settings, inner.clock))
            await bench.nc.connect()
            await bench.wait(_NO_SAFE_POINT_S)
            try:
                yield bench
            finally:
                await bench.nc.close()

    return opened


@asynccontextmanager
async def reference_agent(folder: Path) -> AsyncIterator[NcBench]:
    async with served_agent(workshop_machine()) as served:
        bench = ReferenceAgentBench(served, served.settings(folder))
        await bench.nc.connect()
        try:
            yield bench
        finally:
            await bench.nc.close()


TRAVEL = ((-200.0, 200.0), (-200.0, 200.0), (0.0, 300.0))
FOLLOWING = FollowingTerms(1.0, 120.0, (60.0, 60.0, 60.0), (200.0, 361.0))
"""The terms with which the emulated control follows the nine errors."""
BENCHES: dict[str, Callable[[Path], Opened]] = {
    "in_process": in_process,
    "sinumerik": sinumerik(OffsetRoute()),
    "sinumerik_told_and_by_r": sinumerik(OffsetRoute(route="r"), subscribe_s=0.05),
    "sinumerik_slopes": sinumerik(OffsetRoute(route="k0_slope", travel_mm=TRAVEL, tables={"XY": 0, "YX": 2})),
    "sinumerik_errors": sinumerik(OffsetRoute(route="errors", travel_mm=TRAVEL)),
    "reference_agent": reference_agent,
}
SLOW = {"sinumerik_told_and_by_r", "sinumerik_slopes", "sinumerik_errors"}
