"""`talc-gateway demo --nc linuxcnc`: the gateway's NC side against the real LinuxCNC, with a virtual sphere to probe.

Runs in real time, because LinuxCNC cannot be accelerated. The machine's thermal time can: hours pass between cycles.
"""

import asyncio
import math
import os
import secrets
import shutil
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from drivers.agent.control import AgentControl
from drivers.base import DriverError, Refused
from drivers.linuxcnc.settings import LinuxCncSettings
from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.model.notice import Notify
from gateway.model.probing import End, Outcome
from gateway.model.text import Language, language_wanted
from gateway.nc.link import NcLink
from gateway.nc.probing.cycle import NotBegun, Rejected
from gateway.nc.probing.dry_run import run_dry
from gateway.nc.probing.geometry import geometry_of
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.runtime.clocks import RealClock
from gateway.runtime.terminal import terminal
from simulators.linuxcnc.machine import HURRY, MANUAL, LinuxCncMachine, machine, missing
from simulators.plant import Environment, MachineDrive, Plant, load_machine
from talc.frame import Decision, FloatArray, Measurement, Phase, Why
from talc.names import ERROR_UNITS, THERMAL_ERRORS

HOURS = 4.0
"""Thermal time of the machine between reference and measurement."""
SILENCE_S = 15.0
"""So long a computer with other work may leave the gateway or LinuxCNC without a processor."""
SLEW_UM_PER_S = 100.0
_IDLE_S = 12 * 3600.0
_LOADS = MachineDrive(
    speed_x=6000.0, speed_y=6000.0, speed_a=15.0, speed_c=400.0, spindle_speed=6000.0, coolant_on=True
)
_RADIUS_MM = 200.0
_HEIGHT_MM = 80.0
_CYCLE_LIMIT_S = 240.0
_REFUSED_LIMIT_S = 60.0
_POLL_S = 0.2
_DRY_RUN = 1
"""Number of the dry run's request."""
_DRY_RUN_MM = 50.0
"""Its height."""
_PERIOD_S = 0.05
_MACHINE = {
    **HURRY,
    "SPHERE_RADIUS": _RADIUS_MM,
    "SPHERE_HEIGHT": _HEIGHT_MM,
    "SAFE_Z": 250,
    "PIVOT_X": 3,
    "PIVOT_Y": -4,
    "PIVOT_Z": -5,
    "SLEW": 1,
}
_TOOLS = "T99 P99 Z40 D6 ;touch probe\n"

Announce = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Shown:
    """What the demonstration showed."""

    true: FloatArray
    """(9,) errors of the emulated machine, µm and µm/m."""
    measured: Measurement
    before_um: FloatArray
    """(6, 3) deviation of the sphere at each pose since the reference, without compensation."""
    after_um: FloatArray
    """(6, 3) with compensation. The ball does not grow with the table: where it is touched on one side only, the growth
    over its radius remains, ER0T * ball / radius."""
    silent_um: FloatArray
    """(n, 4) after the last heartbeat: seconds by LinuxCNC's own clock, offsets in force X, Y, Z, µm."""


def run_linuxcnc_demo(folder: Path) -> None:
    """Run it and print the result. Raises DriverError when LinuxCNC is not available here."""
    console, said = terminal(), Language(language_wanted(os.environ))

    def say(line: str) -> None:
        console.print(line, highlight=False)

    shown = asyncio.run(show(folder, say, said, lambda notice: say(said.of(notice.text))))
    heads = (said(f"demo.{name}") for name in ("error", "unit", "true", "measured", "difference"))
    table = Table(*heads, title=said("demo.errors"))
    for name, true, found in zip(THERMAL_ERRORS, shown.true, shown.measured.errors, strict=True):
        table.add_row(name, ERROR_UNITS[name], f"{true:.2f}", f"{found:.2f}", f"{found - true:+.2f}")
    console.print(table)
    heads = (said(f"demo.{name}") for name in ("pose", "pose_without", "pose_with"))
    table = Table(*heads, title=said("demo.sphere"))
    for pose, (before, after) in enumerate(zip(shown.before_um, shown.after_um, strict=True)):
        table.add_row(str(pose + 1), *("  ".join(f"{v:7.2f}" for v in row) for row in (before, after)))
    console.print(table)
    held, zero = silence(shown.silent_um)
    console.print(said("demo.held", held=held, zero=zero), highlight=False)


def silence(silent_um: FloatArray) -> tuple[float, float]:
    """For how many seconds the offsets were held, and after how many they were zero; see Shown.silent_um."""
    times, offsets = silent_um[:, 0], silent_um[:, 1:]
    moved = np.any(np.abs(offsets - offsets[0]) > 0.01, axis=1)
    zero = np.all(np.abs(offsets) < 1e-6, axis=1)
    return float(times[~moved][-1]), float(times[zero][0]) if zero.any() else math.inf


async def show(folder: Path, say: Announce, said: Language, notify: Notify) -> Shown:
    """The whole scene. folder: emptied. notify: called with problems of the control.

    Raises DriverError when LinuxCNC is not available here or a cycle fails.
    """
    if (problem := missing()) is not None:
        raise DriverError(problem)
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "machine").mkdir(parents=True)
    key = secrets.token_hex(32)
    (folder / "talc.key").write_text(key, encoding="ascii")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        say(said("demo.starting"))
        async with machine(folder / "machine", listener, key, sphere=True, settings=_MACHINE, tools=_TOOLS) as operator:
            await operator.ask("switch_on")
            await operator.ask("home")
            await operator.ask("hal", "setp", "talc.may-start", "1")
            return await _scene(operator, folder / "talc.key", listener.getsockname()[1], say, said, notify)


async def _scene(
    operator: LinuxCncMachine, key_file: Path, port: int, say: Announce, said: Language, notify: Notify
) -> Shown:
    clock = RealClock()
    nc = AgentControl(LinuxCncSettings(key_file=key_file, port=port, timeout_s=5.0), clock)
    config = _config(key_file, port)
    probing = config.probing
    try:
        await nc.connect()
        await _stands_no_longer_still(nc)
        say(said("demo.dry", mm=_DRY_RUN_MM))
        await _run_dry(nc, config, clock)
        earlier = Earlier(first_number=_DRY_RUN + 1, paths=frozenset({nc.path_mark}))
        link = NcLink(nc, clock, LinkSettings.of(config, Identity()), earlier, Listeners(notify=notify))
        async with _running(link):
            say(said("demo.reference"))
            reference = (await _measured(link)).centres_mm
            say(said("demo.work", hours=HOURS))
            true = await asyncio.to_thread(_work)  # meanwhile the link has to send its heartbeats
            await operator.ask("deform", true.tolist())
            say(said("demo.without"))
            outcome = await _measured(link)
            if reference is None or outcome.centres_mm is None or outcome.measurement is None:
                raise DriverError("the cycle returned no centres")
            link.follow(_decision(outcome.measurement.errors))
            # During its own cycle the gateway holds the offsets still.
            say(said("demo.again"))
            again = await _looked(operator, len(probing.poses_deg))
        say(said("demo.silent"))
        silent = await _silent(operator)
    finally:
        await nc.close()
    return Shown(
        true=true,
        measured=outcome.measurement,
        before_um=(outcome.centres_mm - reference) * 1e3,
        after_um=(again - reference) * 1e3,
        silent_um=silent,
    )


async def _stands_no_longer_still(nc: AgentControl) -> None:
    """As LinuxCNC may on a computer with other work, after its start too. Raises Refused if it goes on doing so."""
    until = time.monotonic() + _REFUSED_LIMIT_S
    while True:
        try:
            await nc.snapshot()
        except Refused:
            if time.monotonic() >= until:
                raise
            await asyncio.sleep(_POLL_S)
        else:
            return


async def _run_dry(nc: AgentControl, config: GatewayConfig, clock: RealClock) -> None:
    """As at any machine, before the first cycle. Raises DriverError unless it shows that the cycle is free."""
    geometry = geometry_of(config)
    if geometry is None:
        raise DriverError("the configuration has no [nc]")
    try:
        done = await run_dry(
            nc,
            _DRY_RUN,
            geometry,
            clock,
            height_mm=_DRY_RUN_MM,
            poll_s=_POLL_S,
            timeout_s=_CYCLE_LIMIT_S,
            told=lambda _: None,
        )
    except (NotBegun, Rejected) as error:
        raise DriverError(f"dry run: {error}") from error
    if done.wrong:
        raise DriverError(f"dry run: {'; '.join(done.wrong)}")


async def _looked(operator: LinuxCncMachine, poses: int) -> FloatArray:
    """(poses, 3) centres in mm that look.ngc measures."""
    async with asyncio.timeout(_CYCLE_LIMIT_S):
        # The cycle's result comes before its program has given back the tool, and the agent then the operator's mode.
        while not await operator.sees(mode=MANUAL):
            await asyncio.sleep(_POLL_S)
        await operator.ask("run", "look.ngc")
        while not await operator.number("getp", "motion.analog-out-19"):
            await asyncio.sleep(_POLL_S)
    if reason := await operator.number("getp", "motion.analog-out-18"):
        raise DriverError(f"the part program ended with reason {reason:g}")
    found = [await operator.number("getp", f"motion.analog-out-{i:02d}") for i in range(3 * poses)]
    return np.reshape(found, (poses, 3))


def _work() -> FloatArray:
    """(9,) errors after HOURS of work, relative to the idle machine of the reference."""
    plant = Plant(load_machine(), Environment(), seed=1)
    plant.advance(_IDLE_S, MachineDrive())
    plant.zero()
    plant.advance(_IDLE_S + HOURS * 3600.0, _LOADS)
    return plant.errors()


@asynccontextmanager
async def _running(link: NcLink) -> AsyncIterator[None]:
    """The link at work; on exit it disappears without closing, as in a power failure."""
    task = asyncio.create_task(link.run())
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def _silent(operator: LinuxCncMachine) -> FloatArray:
    began = await operator.number("gets", "talc-seconds")
    rows: list[list[float]] = []
    while not rows or any(rows[-1][1:]):
        now = await operator.number("gets", "talc-seconds") - began
        offsets = [await operator.number("gets", f"talc-{axis}-in-force") * 1e3 for axis in "xyz"]
        rows.append([now, *offsets])
        if now > _CYCLE_LIMIT_S:
            raise DriverError("the offsets are still in force: does LinuxCNC's real-time thread run?")
    return np.asarray(rows)


async def _measured(link: NcLink) -> Outcome:
    """The result of a cycle. Raises DriverError with the reason when there is none.

    A control that pauses, as LinuxCNC does on a computer with other work, refuses; it is asked again when it is there.
    """
    until = time.monotonic() + _REFUSED_LIMIT_S
    while True:
        while link.present is None and time.monotonic() < until:
            await asyncio.sleep(_POLL_S)
        outcome = await link.measure(Why.INTERVAL)
        if outcome.measurement is not None:
            return outcome
        if outcome.end is not End.REFUSED or time.monotonic() >= until:
            raise DriverError(f"cycle {outcome.number}: {outcome.reason}")
        await asyncio.sleep(_POLL_S)


def _decision(errors: FloatArray) -> Decision:
    """A decision as if the models predicted exactly what was measured."""
    nan = np.full(len(THERMAL_ERRORS), math.nan)
    return Decision(0, Phase.COMPENSATION, errors, errors, nan, nan, None, None, ())


def _config(key_file: Path, port: int) -> GatewayConfig:
    return validate(
        {
            "machine": {"name": "linuxcnc"},
            "nc": {"kind": "linuxcnc", "key_file": str(key_file), "port": port, "period_s": _PERIOD_S},
            "probing": {
                "armed": True,
                "sphere_radius_mm": _RADIUS_MM,
                "sphere_height_mm": _HEIGHT_MM,
                "poll_s": _POLL_S,
                "timeout_s": _CYCLE_LIMIT_S,
                "reference_cycles": 1,
            },
            "compensation": {
                "mode": "compensate",
                "bound_um": [150.0, 150.0, 150.0],
                "slew_um_per_s": SLEW_UM_PER_S,
                "watchdog_s": SILENCE_S,
            },
        }
    )
