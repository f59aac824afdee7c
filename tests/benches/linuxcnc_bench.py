"""The real LinuxCNC, switched on and homed, with our driver connected through its agent."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.agent.control import AgentControl
from drivers.base import Refused, SystemClock
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.nc import NcSnapshot, WatchdogTerms
from simulators.linuxcnc.machine import LinuxCncMachine, machine

KEY = "0123456789abcdef0123456789abcdef"
ANSWER_S = 60.0
"""The time for one answer of the agent: LinuxCNC works in real time, and is slow on a busy computer."""


@dataclass
class AgentBench:
    """Both sides of the wire."""

    operator: LinuxCncMachine
    nc: AgentControl
    settings: LinuxCncSettings

    @asynccontextmanager
    async def beating(self, owner: int, period_s: float = 0.05) -> AsyncIterator[None]:
        """The gateway lives as long as this. It ends between beats: a cancelled request closes the connection."""
        ended = asyncio.Event()

        async def beat() -> None:
            while not ended.is_set():
                await self.nc.heartbeat(owner)
                with suppress(TimeoutError):
                    await asyncio.wait_for(ended.wait(), period_s)

        task = asyncio.create_task(beat())
        try:
            yield
        finally:
            ended.set()
            await asyncio.gather(task, return_exceptions=True)

    async def snapshot(self) -> NcSnapshot:
        """The driver's. As a gateway does, it asks again where a busy computer let the control stand still."""
        async with asyncio.timeout(60.0):
            while True:
                try:
                    return await self.nc.snapshot()
                except Refused as error:
                    if error.reason != "stale":
                        raise
                    await asyncio.sleep(0.1)

    async def pin(self, name: str) -> float:
        return await self.operator.number("gets", name)

    async def time_s(self) -> float:
        """Seconds as LinuxCNC's own real-time thread counts them, which catches up with what a busy computer took."""
        return await self.pin("talc-seconds")

    async def pass_time(self, seconds: float) -> None:
        """Wait this long by LinuxCNC's own clock."""
        end_s = await self.time_s() + seconds
        async with asyncio.timeout(seconds + 300.0):
            while (left_s := end_s - await self.time_s()) > 0:
                await asyncio.sleep(max(left_s, 0.005))  # each question starts a program


@asynccontextmanager
async def running(
    folder: Path,
    settings: Mapping[str, object],
    *,
    sphere: bool = False,
    tools: str | None = None,
    coordinates: str = "XYZAC",
) -> AsyncIterator[AgentBench]:
    """folder: an empty one. settings: of LinuxCNC's INI file."""
    key_file = folder / "key"
    key_file.write_text(KEY + "\n")
    (folder / "machine").mkdir()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        async with machine(
            folder / "machine",
            listener,
            KEY,
            sphere=sphere,
            settings=settings,
            tools=tools,
            coordinates=coordinates,
        ) as operator:
            await operator.ask("switch_on")
            await operator.ask("home")
            nc_settings = LinuxCncSettings(key_file=key_file, port=listener.getsockname()[1], timeout_s=ANSWER_S)
            bench = AgentBench(operator, AgentControl(nc_settings, SystemClock()), nc_settings)
            await bench.nc.connect()
            try:
                yield bench
            finally:
                await bench.nc.close()
                print("LinuxCNC's messages:", await operator.ask("messages"))  # pytest shows it when a test fails


@contextmanager
def refusal(code: str) -> Iterator[None]:
    """Within, the agent refuses what it is asked, with this code."""
    with pytest.raises(Refused) as refused:
        yield
    assert refused.value.reason == code


async def until(condition: Callable[[], Awaitable[bool]], limit_s: float = 300.0) -> float:
    """Wait until something holds; returns the seconds that it took."""
    began = time.monotonic()
    async with asyncio.timeout(limit_s):
        while not await condition():
            await asyncio.sleep(0.02)
    return time.monotonic() - began


async def claimed(bench: AgentBench, terms: WatchdogTerms) -> None:
    await bench.nc.claim(7, terms)

    async def watched() -> bool:
        return await bench.nc.heartbeat(7)

    await until(watched)


async def until_mark(bench: AgentBench, mark: float) -> None:
    """Wait until the part program has set its mark, analog output 9."""

    async def there() -> bool:
        return await bench.operator.number("getp", "motion.analog-out-09") == mark

    await until(there)
