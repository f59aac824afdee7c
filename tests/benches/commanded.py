"""A gateway without devices that takes commands: link, grid loop and the taker, on a clock that the test drives."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Literal

from gateway.config.sections import Probing
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.text import plain
from gateway.nc.probing.schedule import schedule_of
from gateway.service.command_taker import AskReload, CommandTaker
from gateway.storage.faults import StoreError
from talc.control import Controller
from talc.settings import TalcSettings
from tests.benches.kept_events import KeptEvents
from tests.benches.nc_link_bench import LinkBench, decision
from tests.benches.service_file import MACHINE, adam6015

STEP_S = 300.0
CONFIG = MACHINE + '[storage]\npath = "a.sqlite"\n[talc]\nmethod = "models"\n' + adam6015("a = 0")
NOWHERE = ((0.0, 0.0, 0.0),) * 6


@dataclass
class Commanded:
    """A gateway without devices: link, grid loop and commands."""

    bench: LinkBench
    told: KeptEvents
    taker: CommandTaker
    disk_fails: str = ""
    disk_waits: asyncio.Event | None = None
    """Until then the disk takes nothing."""

    async def give(self, name: CommandName, by: str = "anna", refused: str = "") -> CommandOutcome:
        return await self.taker.take(Command(name, by), plain(refused))

    async def on_disk(self) -> None:
        if self.disk_waits is not None:
            await self.disk_waits.wait()
        if self.disk_fails:
            raise StoreError(self.disk_fails)

    def largest_step_um(self, begins: float = 0.0) -> float:
        """The largest step in everything that was written to the control, one write after the other, a second apart."""
        z = [offsets[2] for _, offsets in self.bench.control.writes]
        return max(abs(b - a) for a, b in zip([begins, *z], z, strict=False))


@asynccontextmanager
async def commanded(
    bench: LinkBench,
    *,
    follow: float | None = None,
    reload: AskReload | None = None,
    method: Literal["models", "learner"] = "models",
    anew: bool = False,
) -> AsyncIterator[Commanded]:
    """follow: the link is given a decision with this error each 30 s, instead of the loop's own. anew: an earlier run
    was asked for a new reference. The learner's input stays at 20 °C."""
    told = KeptEvents()
    plan = schedule_of(Probing(retries=2))
    controller, clock = Controller(("a",), TalcSettings(method=method), STEP_S), bench.clock
    measuring = Measuring(None if follow is not None else bench.link, plan, Probing(), clock, told, anew=anew)
    sampler = GridSampler(("a",), STEP_S)
    loop = GridLoop(
        controller, sampler, Schedule(STEP_S), clock, told,
        measuring, Trainings(controller, clock, told),
        link=None if follow is not None else bench.link,
    )  # fmt: skip
    found = Commanded(bench, told, None)  # type: ignore[arg-type]
    found.taker = CommandTaker(bench.link, measuring, bench.clock, told, found.on_disk, reload)

    async def following(error: float) -> None:
        while True:
            bench.link.follow(decision(error))
            await bench.clock.sleep_until(bench.clock.monotonic() + 30.0)

    async def reading() -> None:
        while True:
            sampler.add_states({"a": 20.0}, bench.clock.monotonic())
            await bench.clock.sleep_until(bench.clock.monotonic() + 30.0)

    tasks = [asyncio.create_task(loop.run())]
    if method == "learner":
        tasks.append(asyncio.create_task(reading()))
    if follow is not None:
        tasks.append(asyncio.create_task(following(follow)))
    try:
        async with bench.running():
            yield found
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
