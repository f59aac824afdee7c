"""`python -m tests.benches.soak --days 30`: the whole service for long, with random faults and restarts.

Faults on every wire and on the control, one at a time (tests/benches/faulty_machine.py), and restarts of the service,
half of them by cancelling it. Prints a table: what was lost, what grew, how late it was, what was not reported and what
was reported without cause.

The service and the emulators run in one process on simulated time (tests/benches/simulated_time.py), with their real
timeouts: how busy the computer is shows in nothing. With `--real` they run in two processes at the computer's own
speed, polled as often as on a machine.
"""

import argparse
import asyncio
import gc
import json
import logging
import os
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import AbstractContextManager, ExitStack, asynccontextmanager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from gateway.commissioning.dry_run import dry_run
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.control import sensor_watch, trainer
from gateway.model.events import CompensationStepped, DecisionMade, EventReported, GatewayEvent, ReadingsTaken
from gateway.runtime.clocks import RealClock
from gateway.runtime.workers.process import in_process
from gateway.service.memory import give_back_large_blocks
from gateway.service.serving import serve
from simulators.bench import gateway_toml
from simulators.bench.machine import DEMO_TERMS
from simulators.clock import SharedClock
from talc.frame import EventKind, FloatArray
from tests.benches.faulty_machine import faulty_machine
from tests.benches.free_port import free_port
from tests.benches.processes import children, open_links
from tests.benches.simulated_time import held_time, jump_wall_clock, real_monotonic_s, simulated_time
from tests.benches.soak_judged import HeldNow, SoakResult, SoakRun, SoakSeen, judged

SLEW_UM_PER_S = 0.3
"""The slew of both the gateway and the control's program on simulated time."""
AS_ON_A_MACHINE = (("= 100.0", "= 1.0"), ("= 30.0 ", "= 1.0 "), ("watchdog_s = 3600.0", "watchdog_s = 10.0"))
"""The periods of the bench's configuration, and those of a machine."""
ON_SIMULATED_TIME = (
    ("[telemetry]", "[telemetry]\nenabled = false"),  # its threads would not wait for it
    ("timeout_s = 2.0", "timeout_s = 60.0"),  # OPC UA's client asks as often as that whether the control is there
    ("= 30.0 ", "= 100.0 "),  # the control as often as the buses: most of the work is that of its emulation
    ("slew_um_per_s = 1.0", f"slew_um_per_s = {SLEW_UM_PER_S}"),  # 30 µm in a period, as before
)
SHORTEST_RUN_S = 1800.0
_HEIGHT_MM, _POLL_S = 50.0, 2.0
"""Of the dry run, without which nothing is measured."""
LOOK_S = 600.0
"""How often the computer's real time is checked, simulated s."""


@dataclass(frozen=True, slots=True)
class SoakPlan:
    """How long, how fast, and how often something happens; seconds are simulated."""

    days: float = 30.0
    seed: int = 1
    pause_s: float = 5400.0
    """Between two faults on average; a fault that is shorter than a wire's period may not be seen."""
    run_s: float = 8 * 3600.0
    """Between two restarts on average."""
    most_real_s: float = float("inf")
    """The real time after which it ends, however many days have passed."""


class SoakClock(RealClock):
    """This process's clock, from zero on, which the emulated machine follows."""

    def __init__(self) -> None:
        self._zero_s = super().monotonic()

    def monotonic(self) -> float:
        return super().monotonic() - self._zero_s


class RightClock(RealClock):
    """The service's clock: kept by a time server, whether this computer has one or not."""

    def synchronised(self) -> bool:
        return True


@asynccontextmanager
async def _machine_apart(folder: Path, epoch: datetime, plan: SoakPlan) -> AsyncIterator[dict[str, int]]:
    """The emulated machine in a separate process, at this computer's speed; yields its ports."""
    clock = SharedClock(folder / "clock", epoch=epoch, owner=True)
    clock.start()
    arguments = (folder, epoch.isoformat(), 1.0, plan.seed, plan.days * 24.0, plan.pause_s)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "tests.benches.faulty_machine", *map(str, arguments)),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("the machine's process has no pipes")
    try:
        yield json.loads(await asyncio.wait_for(process.stdout.readline(), 120.0))
    finally:
        process.stdin.close()
        await asyncio.wait_for(process.wait(), 120.0)
        clock.close()


@asynccontextmanager
async def _machine_here(folder: Path, clock: SoakClock, plan: SoakPlan) -> AsyncIterator[dict[str, int]]:
    """The emulated machine in this process."""
    terms = replace(DEMO_TERMS, slew_um_per_s=SLEW_UM_PER_S)
    async with faulty_machine(folder, clock, plan.seed, plan.days * 24.0, plan.pause_s, terms) as ports:
        yield ports


def config(folder: Path, ports: dict[str, int], *, real: bool) -> GatewayConfig:
    """The bench's configuration, for these addresses."""
    fillings = {
        **ports, "rtu_port": folder / "rtu", "can_port": folder / "can", "growth_port": folder / "growth",
        "folder": folder, "zenoh_port": free_port(), "zenoh_connect": "[]", "talc": "",
    }  # fmt: skip
    text = gateway_toml(fillings)
    for before, after in AS_ON_A_MACHINE if real else ON_SIMULATED_TIME:
        text = text.replace(before, after)
    path = folder / "gateway.toml"
    path.write_text(text, encoding="utf-8")
    return load(path)


def held() -> HeldNow:
    """The resources that this process has now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return HeldNow(
        # Those below /proc/self/task are of simulated time itself, one for each thread that there ever was.
        descriptors=sum("/task/" not in link for link in open_links()),
        threads=threading.active_count(),
        tasks=len(asyncio.all_tasks()),
        resident_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
    )


class Watching:
    """A gateway.model.events.Sink for all runs of a soak."""

    def __init__(self, seen: SoakSeen, clock: RealClock, step_s: float) -> None:
        self._seen, self._clock, self._step_s = seen, clock, step_s
        self._offsets: FloatArray | None = None
        self._across = False

    def begin(self) -> None:
        """Begin another run of the service."""
        self._across = True

    def take(self, event: GatewayEvent) -> None:
        match event:
            case DecisionMade():
                self._seen.lags_s.append(self._clock.utc().timestamp() - event.decision.k * self._step_s)
            case ReadingsTaken():
                self._seen.readings += len(event.readings)
            case EventReported() if event.event.kind is EventKind.PROBLEM and event.event.text.startswith("NC: "):
                # The control holds offsets without the gradients behind them, and may have taken one write more than
                # was answered. tests/benches/nc_disturbances.py judges these moments on the control itself.
                self._offsets = None
            case CompensationStepped() if event.write.written:
                # The coefficients, as the offset at the tool also changes when the axes move. A row's sum is the most
                # that its axis can change by, wherever the tool is.
                step = event.write.step
                now = np.array(step.coefficients_um or [[offset] for offset in step.offsets_um])
                if self._offsets is not None and self._offsets.shape == now.shape:
                    kind = "across" if self._across else "within"
                    change = float(np.abs(now - self._offsets).sum(axis=1).max())
                    self._seen.changes_um[kind] = max(change, self._seen.changes_um.get(kind, 0.0))
                self._offsets, self._across = now, False
            case _:
                pass


async def soaked(
    folder: Path, plan: SoakPlan, *, real: bool = False, told: Callable[[str], None] = lambda _: None
) -> SoakResult:
    """Run everything in this folder, and judge it. Within `simulated_time`, unless it is real.

    told: gets a line at the end of each run
    """
    random, clock, seen = np.random.default_rng(plan.seed), SoakClock(), SoakSeen()
    epoch, total_s, began_s = clock.utc(), plan.days * 86400.0, real_monotonic_s()
    whole = _machine_apart(folder, epoch, plan) if real else _machine_here(folder, clock, plan)
    async with whole as ports:
        settings = config(folder, ports, real=real)
        await dry_run(settings, clock, _HEIGHT_MM, _POLL_S, told)
        watching = Watching(seen, clock, settings.grid.step_s)
        if settings.nc is not None and settings.compensation is not None:
            seen.slew_um = settings.compensation.slew_um_per_s * settings.nc.period_s
        end_s = began_s + plan.most_real_s
        while (now_s := clock.monotonic()) < total_s and real_monotonic_s() < end_s:
            shortest_s = min(SHORTEST_RUN_S, plan.run_s / 2)
            until_s = min(total_s, now_s + shortest_s + random.exponential(plan.run_s - shortest_s))
            ending = _reached(clock, until_s, end_s)
            seen.runs.append(await _run(settings, clock, ending, watching, properly=bool(random.random() < 0.5)))
            told(_progress(seen, real_monotonic_s() - began_s))
    seen.real_s, seen.children = real_monotonic_s() - began_s, len(children(os.getpid()))
    return judged(folder, settings, epoch, seen)


async def _reached(clock: SoakClock, until_s: float, real_until_s: float) -> None:
    """Wait until a simulated time, or until soon after a real one."""
    while (now_s := clock.monotonic()) < until_s and real_monotonic_s() < real_until_s:
        await clock.sleep_until(min(until_s, now_s + LOOK_S))


def _progress(seen: SoakSeen, real_s: float) -> str:
    latest = seen.runs[-1]
    return (
        f"{latest.end_s / 86400.0:.2f} days in {real_s:.0f} s: {len(seen.runs)} runs, {seen.readings} readings, "
        f"{latest.working.resident_mb:.0f} MB"
    )


async def _run(
    settings: GatewayConfig, clock: SoakClock, end: Coroutine[Any, Any, None], watching: Watching, *, properly: bool
) -> SoakRun:
    """One run of the service."""
    stop, begin_s = asyncio.Event(), clock.monotonic()
    watching.begin()
    running = asyncio.create_task(serve(settings, RightClock(), stop, simulated=True, more=[watching.take]))
    ending = asyncio.create_task(end)
    await asyncio.wait([running, ending], return_when=asyncio.FIRST_COMPLETED)
    end_s, working = clock.monotonic(), held()
    if properly:
        stop.set()
    else:
        running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    ending.cancel()
    await asyncio.gather(ending, return_exceptions=True)
    return SoakRun(begin_s, end_s, properly, working, resting=held())


def table(found: SoakResult) -> str:
    """The result as Markdown; what counts against the gateway follows, line by line."""
    lines = ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in found.rows), ""]
    lines += [f"leaked: {leak}" for leak in found.leaks]
    lines += [f"not reported: {fault.name}, from {fault.begin_s:.0f} to {fault.end_s:.0f} s" for fault in found.missed]
    for what, alarms in (("false alarm", found.false), ("asked again", found.asked_again)):
        lines += [f"{what}: at {alarm.at_s:.0f} s, {alarm.kind.value}: {alarm.text}" for alarm in alarms]
    return "\n".join(lines)


async def _in_process_while_time_stands(work: Callable[..., Any], *given: Any, **named: Any) -> Any:
    with held_time():
        return await in_process(work, *given, **named)


@contextmanager
def fast_forward() -> Iterator[None]:
    """Inside, simulated time, which waits for the processes that learn."""
    with ExitStack() as stack:
        for module in (sensor_watch, trainer):
            stack.enter_context(patch.object(module, "in_process", _in_process_while_time_stands))
        stack.enter_context(simulated_time())
        yield


def main() -> None:
    """Print the table; exit code 1 if something was lost, not reported, reported for nothing, leaked, or stepped."""
    plain = SoakPlan()
    options = argparse.ArgumentParser(description="The whole service with random faults and restarts.")
    options.add_argument("--days", type=float, default=plain.days, help="simulated")
    options.add_argument("--seed", type=int, default=plain.seed)
    options.add_argument("--pause", type=float, default=plain.pause_s, help="between two faults, simulated s")
    options.add_argument("--run", type=float, default=plain.run_s, help="between two restarts, simulated s")
    options.add_argument(
        "--minutes", type=float, default=float("inf"), help="end after this time of the computer's own"
    )
    options.add_argument("--begin", type=int, help="on simulated time, s since 1970; default: now")
    options.add_argument("--real", action="store_true", help="at the computer's own speed")
    options.add_argument("--folder", type=Path, help="keep everything there; default: a temporary folder")
    given = options.parse_args()
    plan = SoakPlan(given.days, given.seed, given.pause, given.run, 60.0 * given.minutes)
    logging.disable(logging.CRITICAL)
    give_back_large_blocks()  # as `run` does
    pace: AbstractContextManager[None] = nullcontext() if given.real else fast_forward()
    with tempfile.TemporaryDirectory() as name, pace:
        folder = given.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        if given.begin is not None:  # the moment decides what happens, too
            jump_wall_clock(given.begin - int(time.time()))
        found = asyncio.run(
            soaked(folder, plan, real=given.real, told=lambda line: print(line, file=sys.stderr, flush=True))
        )
    print(table(found))
    sys.exit(not found.good)


if __name__ == "__main__":
    main()
