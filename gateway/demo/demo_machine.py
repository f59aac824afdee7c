"""The emulated machine of the demo, in a separate process, and the gateway's configuration for it."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from sys import executable
from typing import Literal

from drivers.base import DriverError
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from simulators.bench import gateway_toml
from simulators.clock import SharedClock

_EPOCH = datetime(2026, 1, 5, 6, tzinfo=UTC)
"""A Monday morning."""
STEPS_PER_HOUR = 12
_LIMITS = """[talc.learner]
limit_um = 2.5                     # 5 and 15 by default; Y moves by 7 µm RMS, and is worth more measurements
limit_um_per_m = 7.5
"""
_PLANNED_LOAD = """
# What a person may plan; from the third day on, the page says when the machine would be ready (docs/page.md).
[[planned_load]]
name = "warm-up"
loads = {spindle_speed = 8000.0, speed_X = 6000.0, speed_Y = 6000.0}   # 1/min, mm/min: means while it runs
"""
_READY_LIMIT_S = 900.0
"""An idle computer needs a few seconds; one that another computer emulates, minutes."""
_END_LIMIT_S = 10.0


@dataclass(frozen=True, slots=True)
class Demo:
    """What to run."""

    hours: float
    method: Literal["learner", "models"]
    preset: str | None
    """One of talc.presets.PRESETS; its method is `models`."""
    calibration_hours: float | None
    """Length of the phase `calibration` of `models`; None: as the preset or the default has it."""
    speed: float
    seed: int
    folder: Path
    zenoh_port: int
    connect: tuple[str, ...]
    plain: bool


@asynccontextmanager
async def on_emulated_machine(demo: Demo) -> AsyncIterator[tuple[GatewayConfig, SharedClock]]:
    """The emulated machine in a separate process, the gateway's configuration for it, and the clock, not started.

    Raises DriverError when the machine does not start.
    """
    clock = SharedClock(demo.folder / "clock", epoch=_EPOCH, speed=demo.speed, owner=True)
    try:
        async with _machine(demo) as addresses:
            yield _config(demo, addresses), clock
    finally:
        clock.close()


@asynccontextmanager
async def _machine(demo: Demo) -> AsyncIterator[dict[str, str | int]]:
    """The emulated machine's process; yields its addresses. It ends when its standard input closes."""
    process = await asyncio.create_subprocess_exec(
        executable,
        *("-m", "simulators.bench", str(demo.folder), _EPOCH.isoformat(), str(demo.speed), str(demo.seed)),
        str(demo.hours),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the gateway; the machine ends after it
    )
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("the machine's process has no pipes")
    try:
        try:
            line = await asyncio.wait_for(process.stdout.readline(), _READY_LIMIT_S)
            addresses: dict[str, str | int] = json.loads(line)
        except TimeoutError:
            raise DriverError(
                f"the emulated machine was not ready within {_READY_LIMIT_S:g} s; end other programs and try again"
            ) from None
        except json.JSONDecodeError:
            raise DriverError("the emulated machine did not start; see its message above") from None
        yield addresses
    finally:
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _END_LIMIT_S)
        except TimeoutError:
            process.kill()
            await process.wait()


def _config(demo: Demo, addresses: dict[str, str | int]) -> GatewayConfig:
    """Fill the bench's addresses into the configuration, and load it like any other."""
    fillings: dict[str, str | int] = addresses | {
        "folder": str(demo.folder.resolve()),
        "zenoh_port": demo.zenoh_port,
        "zenoh_connect": json.dumps(demo.connect),
        "talc": talc_section(demo),
    }
    path = demo.folder / "gateway.toml"
    path.write_text(gateway_toml(fillings), encoding="utf-8")
    return load(path)


def talc_section(demo: Demo) -> str:
    """The keys of `[talc]`, and what stands below it: the method's own keys, and the load that a person may plan."""
    lines = [f'method = "{demo.method}"' if demo.preset is None else f'preset = "{demo.preset}"']
    if demo.calibration_hours is not None:
        lines += ["[talc.control]", f"calibration_steps = {round(demo.calibration_hours * STEPS_PER_HOUR)}"]
    if demo.method == "learner" and demo.preset is None:
        lines += [_LIMITS, _PLANNED_LOAD]
    return "\n".join(lines)
