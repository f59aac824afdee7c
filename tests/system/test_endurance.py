"""A simulated day of faults on every wire and on the control: the whole service does not grow."""

import asyncio
import gc
import json
import logging
import os
import sys
import threading
import tracemalloc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from gateway.commissioning.dry_run import dry_run
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.service.serving import serve
from gateway.storage.history import History
from simulators.bench import gateway_toml
from simulators.clock import SharedClock
from talc.frame import EventKind, Phase
from tests.benches.faulty_machine import FAULT_EVERY_S
from tests.benches.free_port import free_port
from tests.benches.processes import children, open_links

EPOCH = datetime(2026, 1, 5, 6, tzinfo=UTC)
HOURS, SETTLED_HOURS, COMPARED_HOURS = 24.0, 8.0, 3.0
SPEED = 6000.0
SEED = 5
CALIBRATION_STEPS = 60
TALC = f'method = "models"\n[talc.control]\ncalibration_steps = {CALIBRATION_STEPS}'
SAMPLE_S = 600.0
FRAME_BYTES = 3_000
"""What a grid step may leave: the controller, the sensor watch and the store's cache keep frames."""


@dataclass(frozen=True)
class HeldByProcess:
    """What the process has open at one moment."""

    hour: float
    descriptors: int
    threads: int
    tasks: int
    traced_bytes: int


def held(hour: float) -> HeldByProcess:
    traced = tracemalloc.get_traced_memory()[0]
    return HeldByProcess(hour, len(open_links()), threading.active_count(), len(asyncio.all_tasks()), traced)


@asynccontextmanager
async def machine(folder: Path) -> AsyncIterator[dict[str, int]]:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "tests.benches.faulty_machine", str(folder), EPOCH.isoformat(), str(SPEED), str(SEED)),
        str(HOURS),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        yield json.loads(await asyncio.wait_for(process.stdout.readline(), 300.0))
    finally:
        process.stdin.close()
        await asyncio.wait_for(process.wait(), 300.0)


def config(folder: Path, ports: dict[str, int]) -> GatewayConfig:
    fillings = {
        **ports, "rtu_port": folder / "rtu", "can_port": folder / "can", "growth_port": folder / "growth",
        "folder": folder, "zenoh_port": free_port(), "zenoh_connect": "[]", "talc": TALC,
    }  # fmt: skip
    text = gateway_toml(fillings)
    path = folder / "gateway.toml"
    for before, after in (("timeout_s = 0.5", "timeout_s = 0.1"), ("= 100.0", "= 150.0"), ("= 30.0 ", "= 60.0 ")):
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")
    return load(path)


async def sampled(clock: SharedClock, stop: asyncio.Event) -> tuple[list[HeldByProcess], list[HeldByProcess]]:
    """Every ten minutes of the hours that are compared, early and late; at the end of the day, stop."""
    early: list[HeldByProcess] = []
    late: list[HeldByProcess] = []
    due = SAMPLE_S
    while (hour := clock.monotonic() / 3600.0) < HOURS:
        await clock.sleep_until(due)
        due += SAMPLE_S
        if hour >= SETTLED_HOURS and not tracemalloc.is_tracing():
            tracemalloc.start()
        if SETTLED_HOURS + 0.5 <= hour < SETTLED_HOURS + COMPARED_HOURS:
            into = early
        elif hour >= HOURS - COMPARED_HOURS:
            into = late
        else:
            continue  # collecting the garbage of the whole process takes long
        with clock.hold():
            gc.collect()
            into.append(held(hour))
    stop.set()
    return early, late


@pytest.mark.slow
async def test_a_day_of_faults_leaves_nothing_behind(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)  # pytest keeps every record
    clock, stop = SharedClock(tmp_path / "clock", epoch=EPOCH, speed=SPEED, owner=True), asyncio.Event()
    sampling: asyncio.Task[tuple[list[HeldByProcess], list[HeldByProcess]]] | None = None
    try:
        async with machine(tmp_path) as ports:
            settings = config(tmp_path, ports)
            clock.start()
            await dry_run(settings, clock, 50.0, 2.0, lambda _: None)
            clock.stop()
            sampling = asyncio.create_task(sampled(clock, stop))
            await serve(settings, clock, stop, simulated=True, started=lambda _: clock.start())
            clock.stop()
        early, late = await sampling
    finally:
        tracemalloc.stop()
        if sampling is not None:
            sampling.cancel()
            with suppress(asyncio.CancelledError):
                await sampling
        clock.close()

    # Nearly the most: a closed bus has fewer, and on a busy computer it is closed half of the time.
    for what in ("descriptors", "threads", "tasks"):
        usual = [float(np.percentile([getattr(h, what) for h in some], 90)) for some in (early, late)]
        assert usual[1] <= usual[0] + 2, f"{what}: {usual}"
    frames = (late[-1].hour - early[0].hour) * 12
    grown = float(np.median([h.traced_bytes for h in late]) - np.median([h.traced_bytes for h in early]))
    assert grown < FRAME_BYTES * frames, f"{grown:.0f} bytes in {frames:.0f} frames"
    assert children(os.getpid()) == []

    with History(tmp_path / "gateway.sqlite") as history:
        steps, events = list(history.steps()), history.events()
    faults = HOURS * 3600.0 / FAULT_EVERY_S
    kinds = [event.kind for _, _, event in events]
    assert len(steps) >= 0.98 * HOURS * 12
    assert kinds.count(EventKind.PROBLEM) >= 0.9 * faults
    assert abs(kinds.count(EventKind.PROBLEM) - kinds.count(EventKind.PROBLEM_ENDED)) <= 2
    assert steps[-1].decision.phase is not Phase.CALIBRATION
    assert any(step.adopted for step in steps)
