"""`talc-gateway demo`: an emulated machine in a second process and the gateway in this one, over real protocols."""

import asyncio
import os
import shlex
import socket
from pathlib import Path
from typing import Any, Literal

import click
from rich.console import Console

from gateway.commissioning.dry_run import dry_run
from gateway.demo.demo_machine import STEPS_PER_HOUR, Demo, on_emulated_machine
from gateway.demo.demo_page import PAGE_LOG, demo_page
from gateway.demo.demo_replay import run_replay
from gateway.listeners.watch.view import LiveView, ViewState, feeding
from gateway.model.text import Language, language_wanted
from gateway.runtime.extras import lack_of
from gateway.runtime.signals import stop_on_signals
from gateway.runtime.terminal import terminal
from gateway.service.report_data import Reader
from gateway.service.report_file import write
from gateway.service.serving import serve
from simulators.clock import SharedClock
from talc.presets import PRESETS
from talc.settings import ControlSettings

_LEAVINGS = (
    "gateway.sqlite",
    "gateway.sqlite-wal",
    "gateway.sqlite-shm",
    "truth.csv",
    "clock",
    "report.html",
    "report.png",
    PAGE_LOG,
)
_HEIGHT_MM = 50.0
"""Of the dry run, which comes before everything else as at any machine."""
_POLL_S = 2.0
"""Between two looks at it."""
_TOLERANCE_UM = 8.0
_USE = f"[machine.bench]\ntolerance_um = {_TOLERANCE_UM}\nsphere_radius_mm = 200.0\nsphere_height_mm = 80.0\n"
"""What its page knows of it: a job's tolerance, and [probing] of simulators/bench/gateway.toml."""


def wanted(*, method: Literal["learner", "models"] | None, preset: str | None, **given: Any) -> Demo:
    """What the options ask for; a preset is a system of models. Raises UsageError."""
    if preset is not None and method == "learner":
        raise click.UsageError(f"--preset {preset} is a system of models, not the learner")
    return Demo(method=method or ("learner" if preset is None else "models"), preset=preset, **given)


def run_demo(demo: Demo) -> None:
    """Run it, then print the table and write the report."""
    _check_calibration(demo)
    _check_port(demo.zenoh_port)
    demo.folder.mkdir(parents=True, exist_ok=True)
    for name in _LEAVINGS:
        (demo.folder / name).unlink(missing_ok=True)
    console, said = terminal(), Language(language_wanted(os.environ))
    asyncio.run(_run(demo, console, said))
    console.print()
    reader = Reader(language=said.code, tolerance_um=_TOLERANCE_UM)
    write(demo.folder / "gateway.sqlite", demo.folder / "report.html", demo.folder / "truth.csv", reader)
    console.print(said("demo.replay", file=str(demo.folder / "gateway.sqlite")), soft_wrap=True)
    page, folder = (demo.folder / "report.html").resolve().as_uri(), shlex.quote(str(demo.folder))
    console.print(said("demo.look", page=page, folder=folder), soft_wrap=True)


def replay_demo(folder: Path, port: int) -> None:
    """Play its days again for its page. Raises StoreError when there is none in this folder."""
    _check_port(port)
    run_replay(folder, port, _USE)


async def _run(demo: Demo, console: Console, said: Language) -> None:
    async with (
        demo_page(demo.folder, demo.zenoh_port, _USE) as page,
        on_emulated_machine(demo) as (config, clock),
    ):
        line = said("demo.page_absent", why=lack_of("web")) if page is None else await page.line(said)
        console.print(line, highlight=False, soft_wrap=True)
        clock.start()
        await dry_run(
            config,
            clock,
            _HEIGHT_MM,
            _POLL_S,
            lambda state: console.print(said("demo.dry_run", line=said.word("dry_run_state", state)), highlight=False),
        )
        clock.stop()
        stop = asyncio.Event()
        stop_on_signals(stop)
        state = ViewState(machine=config.machine.name)
        state.progress_until_s = demo.hours * 3600.0
        view = feeding(state, config.input_names, clock, simulated=True)
        with LiveView(state, plain=demo.plain, language=said.code):
            ender = asyncio.create_task(_end_at(clock, demo.hours * 3600.0, stop))
            try:
                await serve(config, clock, stop, simulated=True, more=[view], started=lambda _: clock.start())
            finally:
                ender.cancel()
                clock.stop()


async def _end_at(clock: SharedClock, time_s: float, stop: asyncio.Event) -> None:
    await clock.sleep_until(time_s)
    stop.set()


def _check_calibration(demo: Demo) -> None:
    """Raises UsageError when it is not there, or longer than the run."""
    if demo.method == "learner":
        if demo.calibration_hours is not None:
            raise click.UsageError("--calibration-hours is for --method models and --preset: the learner has none")
        return
    control = ControlSettings() if demo.preset is None else PRESETS[demo.preset].control
    hours = demo.calibration_hours or control.calibration_steps / STEPS_PER_HOUR
    if hours >= demo.hours:
        raise click.UsageError(f"the calibration of {hours:g} h leaves no time in --hours {demo.hours:g}")


def _check_port(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise OSError(f"port {port} on 127.0.0.1 cannot be used: {error.strerror}; give --zenoh-port") from error
