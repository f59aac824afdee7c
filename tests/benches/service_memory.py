"""`python -m tests.benches.service_memory --days 30`: the memory of the service alone, day after day.

The service of the demo's machine as `run` sets it up: 29 channels and a displacement on four buses, the control,
learning, the store, Zenoh. The emulated machine is a separate process and does not count, nor does a view. The clock
is the demo's. Prints a Markdown table: in the middle of each simulated day the memory of this process (PSS: its own,
and its share of libraries that others use, too), and the most private memory that it had since the previous line,
looked at each 5 ms: at the end of a day a snapshot is made.
"""

import argparse
import asyncio
import logging
import os
import tempfile
import threading
import time
from pathlib import Path

from gateway.demo.demo_machine import Demo, on_emulated_machine
from gateway.service.memory import give_back_large_blocks
from gateway.service.serving import serve
from simulators.clock import SharedClock
from tests.benches.free_port import free_port

DAY_S = 86400.0


def memory_mb() -> dict[str, float]:
    """This process's memory now: RSS and PSS, and the part of both that is not pages of files; MB."""
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    kb = {name: float(value.split()[0]) for name, value in (line.split(":") for line in lines)}
    of = {"RSS": "Rss", "PSS": "Pss", "of it not pages of files": "Pss_Anon"}
    return {shown: kb[name] * 1024 / 1e6 for shown, name in of.items()}


class Peak(threading.Thread):
    """Looks at how much of this process's memory is not pages of files, often enough to see a snapshot being made."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._most_pages = 0

    def run(self) -> None:
        """Never returns."""
        while True:
            _, resident, shared, *_ = map(int, Path("/proc/self/statm").read_text(encoding="ascii").split())
            self._most_pages = max(self._most_pages, resident - shared)
            time.sleep(0.005)

    def taken_mb(self) -> float:
        """The most since the last call."""
        most, self._most_pages = self._most_pages, 0
        return most * os.sysconf("SC_PAGE_SIZE") / 1e6


async def _days(clock: SharedClock, days: int, stop: asyncio.Event) -> None:
    peak = Peak()
    peak.start()
    print(
        "| simulated day | PSS, MB | of it not pages of files, MB | the most of that, MB |\n|---|---|---|---|",
        flush=True,
    )
    for day in (0.04, *(day + 0.5 for day in range(days))):
        await clock.sleep_until(day * DAY_S)
        found = memory_mb()
        print(
            f"| {day:g} | {found['PSS']:.0f} | {found['of it not pages of files']:.0f} | {peak.taken_mb():.0f} |",
            flush=True,
        )
    stop.set()


async def measured(demo: Demo) -> None:
    """Run the service for these days, and print the table."""
    async with on_emulated_machine(demo) as (config, clock):
        stop = asyncio.Event()
        counting = asyncio.create_task(_days(clock, round(demo.hours / 24.0), stop))
        try:
            await serve(config, clock, stop, simulated=True, started=lambda _: clock.start())
        finally:
            counting.cancel()
            clock.stop()


def main() -> None:
    options = argparse.ArgumentParser(description="The memory of the service alone.")
    options.add_argument("--days", type=int, default=30, help="simulated")
    options.add_argument("--speed", type=float, default=20000.0, help="highest speed of the simulated clock")
    given = options.parse_args()
    logging.disable(logging.CRITICAL)
    give_back_large_blocks()  # as `run` does
    with tempfile.TemporaryDirectory() as folder:
        place, hours = Path(folder), 24.0 * given.days
        asyncio.run(measured(Demo(hours, "learner", None, None, given.speed, 1, place, free_port(), (), plain=True)))


if __name__ == "__main__":
    main()
