"""`python -m tests.benches.snapshot_memory CONFIG COUNT`: runs only the store of `run`, which takes snapshots.

A day passes between two of them. Prints the process's memory in MB, once the learner has learnt and after each one, and
the most since the line before.
"""

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np

from gateway.acquisition.wire_log import WireLogWriter
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import earlier_run
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import DecisionMade, FrameMade, Sink
from gateway.model.text import Text
from gateway.runtime.clocks import ServiceClock
from gateway.service.run import run_service
from gateway.service.service import Service
from gateway.storage.store import Store
from talc.frame import Frame, Measurement

STEPS_A_DAY = 24


def resident_mb() -> float:
    """The resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def most_mb() -> float:
    """The most that this process had since the last call, MB."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (kb,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return float(kb) * 1024 / 1e6


def taken(config: GatewayConfig, clock: ServiceClock, count: int) -> None:
    """Take this many snapshots, each after the previous one is on the disk."""
    draw, names = np.random.default_rng(1), config.input_names
    with Store(config.storage.path, "first", clock) as store:
        past = earlier_run(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
        keeper = SnapshotKeeper(past, store, config, every_steps=STEPS_A_DAY)
        for k in range(STEPS_A_DAY * (count + 1)):
            measured = Measurement(draw.normal(0, 5, 9), np.full(9, 0.5)) if k % 12 == 0 else None
            frame = Frame(k, 20.0 + draw.normal(0, 2, len(names)), np.full(len(names), fill_value=True), measured)
            if k % STEPS_A_DAY == STEPS_A_DAY - 1:
                store.flush()
                store.flush()  # now the writer no longer holds the last row before it
                print(resident_mb(), most_mb(), flush=True)
            for event in (FrameMade(frame), DecisionMade(past.controller.step(frame))):
                store.record(event)
                keeper.take(event)


def main(path: Path, count: int) -> None:
    async def snapshots_alone(
        config: GatewayConfig,
        clock: ServiceClock,
        _: asyncio.Event,
        *,
        simulated: bool,
        more: Sequence[Sink] = (),
        started: Callable[[Service], None],
        wire_log: WireLogWriter | None,
        reload: Callable[[Service], Awaitable[Text]],
    ) -> None:
        taken(config, clock, count)

    with patch("gateway.service.run.serve", snapshots_alone):
        run_service(load(path), path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
