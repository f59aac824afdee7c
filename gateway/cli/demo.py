"""`talc-gateway demo`: an emulated machine in a second process and the gateway in this one, over real protocols."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from sys import executable
from typing import Literal

import click

from drivers.base import DriverError
from gateway.cli.report import write
from gateway.cli.running import serve
from gateway.cli.signals import stop_on_signals
from gateway.cli.terminal import terminal
from gateway.cli.view import LiveView, ViewState, feeding
from gateway.config import GatewayConfig, load
from simulators.clock import SharedClock
from talc.presets import PRESETS
from talc.settings import ControlSettings

_EPOCH = datetime(2026, 1, 5, 6, tzinfo=UTC)
"""A Monday morning."""
_STEPS_PER_HOUR = 12
_READY_LIMIT_S = 900.0
"""An idle computer needs a few seconds; one that another computer emulates, minutes."""
_END_LIMIT_S = 10.0
_LEAVINGS = (
    "gateway.sqlite",
    "gateway.sqlite-wal",
    "gateway.sqlite-shm",
    "truth.csv",
    "clock",
    "report.html",
    "report.png",
)


@dataclass(frozen=True, slots=True)
class Demo:
    """What to run."""

    hours: float
    method: Literal["learner", "models"]
    preset: str | None
    """One of talc.presets.PRESETS; its method is `models`."""
    calibration_hours: float | None
    """Of `models`; None: as the preset or the default has it."""
    speed: float
    seed: int
    folder: Path
    zenoh_port: int
    connect: tuple[str, ...]
    plain: bool


def run_demo(demo: Demo) -> None:
    """Run it, then print the table and write the report."""
    _check_calibration(demo)
    _check_port(demo.zenoh_port)
    demo.folder.mkdir(parents=True, exist_ok=True)
    for name in _LEAVINGS:
        (demo.folder / name).unlink(missing_ok=True)
    console = terminal()
    page = f"talc-gateway web --connect tcp/127.0.0.1:{demo.zenoh_port}"
    console.print(f"its page, from a second terminal: {page}", highlight=False, soft_wrap=True)
    asyncio.run(_run(demo))
    console.print()
    write(demo.folder / "gateway.sqlite", demo.folder / "report.html", truth=demo.folder / "truth.csv")
    console.print(f"replay: talc-gateway replay {demo.folder / 'gateway.sqlite'}")


async def _run(demo: Demo) -> None:
    clock = SharedClock(demo.folder / "clock", epoch=_EPOCH, speed=demo.speed, owner=True)
    try:
        async with _machine(demo) as addresses:
            config = _config(demo, addresses)
            stop = asyncio.Event()
            stop_on_signals(stop)
            state = ViewState(machine=config.machine.name)
            state.progress_until_s = demo.hours * 3600.0
            view = feeding(state, config.input_names, clock, simulated=True)
            with LiveView(state, plain=demo.plain):
                ender = asyncio.create_task(_end_at(clock, demo.hours * 3600.0, stop))
                try:
                    await serve(config, clock, stop, simulated=True, more=[view], started=lambda _: clock.start())
                finally:
                    ender.cancel()
                    clock.stop()
    finally:
        clock.close()


async def _end_at(clock: SharedClock, time_s: float, stop: asyncio.Event) -> None:
    await clock.sleep_until(time_s)
    stop.set()


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
    text = files("simulators.bench").joinpath("gateway.toml").read_text(encoding="utf-8")
    fillings: dict[str, str | int] = addresses | {
        "folder": str(demo.folder.resolve()),
        "zenoh_port": demo.zenoh_port,
        "zenoh_connect": json.dumps(demo.connect),
        "talc": talc_section(demo),
    }
    for name, value in fillings.items():
        text = text.replace("{" + name + "}", str(value))
    path = demo.folder / "gateway.toml"
    path.write_text(text, encoding="utf-8")
    return load(path)


def talc_section(demo: Demo) -> str:
    """The keys of `[talc]`, and of `[talc.control]` below it."""
    lines = [f'method = "{demo.method}"' if demo.preset is None else f'preset = "{demo.preset}"']
    if demo.calibration_hours is not None:
        lines += ["[talc.control]", f"calibration_steps = {round(demo.calibration_hours * _STEPS_PER_HOUR)}"]
    return "\n".join(lines)


def _check_calibration(demo: Demo) -> None:
    """Raises UsageError when it is not there, or longer than the run."""
    if demo.method == "learner":
        if demo.calibration_hours is not None:
            raise click.UsageError("--calibration-hours is for --method models and --preset: the learner has none")
        return
    control = ControlSettings() if demo.preset is None else PRESETS[demo.preset].control
    hours = demo.calibration_hours or control.calibration_steps / _STEPS_PER_HOUR
    if hours >= demo.hours:
        raise click.UsageError(f"the calibration of {hours:g} h leaves no time in --hours {demo.hours:g}")


def _check_port(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise OSError(f"port {port} on 127.0.0.1 cannot be used: {error.strerror}; give --zenoh-port") from error
