"""Deviations that are left at the tool of a real LinuxCNC in motion, with errors that are known exactly.

They are measured in LinuxCNC's own servo periods, for each way in which offsets can reach it.

`python -m tests.benches.linuxcnc_motion` prints the table of docs/linuxcnc.md, in five minutes of real time.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drivers.agent.control import AgentControl
from drivers.base import SystemClock
from drivers.nc import NineErrors, WatchdogTerms
from gateway.config.extended import validate
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.runtime.clocks import RealClock
from simulators.linuxcnc.machine import HURRY
from talc import kinematics
from talc.frame import Decision, FloatArray, Phase
from tests.benches.linuxcnc_bench import AgentBench, claimed, running, until_mark

WARM = np.array([2.1, 88.8, 11.3, 6.4, 21.7, 12.6, 35.0, -18.0, 24.0])
"""µm and µm/m: ER0T and EZ0A of the emulated machine after four hours of work, the others of their usual size."""
RADIUS_MM = 120.0
SIGNALS = ("talc-x-cmd", "talc-y-cmd", "talc-z-cmd", "talc-a-cmd", *(f"talc-{axis}-in-force" for axis in "xyz"))
MOTIONS: Mapping[str, str] = {
    "X ± 150 mm at 10 m/min": "G1 F10000 X150\nX-150\n",
    "circle of 120 mm, C at 60°/s": "G1 F10000 X60 Y0\nG2 X60 Y0 I-60 J0 C[#1 * 360] F3770\n",
    "A ± 60° at 60°/s": "G1 A60 F3600\nA-60\n",
}
_PROGRAM = (
    "#1 = 1\nG21 G90 G64\nG53 G0 X60 Y0 Z80 A{a} C0\nM68 E9 Q{mark}\n"
    "o1 while [#1 LT 90]\n{motion}#1 = [#1 + 1]\no1 endwhile\nM2\n"
)
_MACHINE = {
    **HURRY,
    **{"MAX_ACCELERATION": 2000, "MAX_LINEAR_ACCELERATION": 2000, "MAX_ANGULAR_ACCELERATION": 20000},
    **{"SLEW": 10, "LOWER": -0.5, "BOUND": 0.5},
}


class ShiftsOnly(AgentControl):
    """A control that takes only shifts, as with an agent that offers nothing else."""

    @property
    def error_reach_mm(self) -> None:
        return None


@asynccontextmanager
async def in_motion(bench: AgentBench, folder: Path, motion: str) -> AsyncIterator[None]:
    """The part program runs, and is where the motion begins. folder: where LinuxCNC's INI file is."""
    mark = 1 + list(MOTIONS).index(motion)
    program = _PROGRAM.format(motion=MOTIONS[motion], mark=mark, a=30 if motion.startswith("X") else 0)
    (folder / "motion.ngc").write_text(program)
    await bench.operator.ask("run", "motion.ngc")
    await until_mark(bench, mark)
    try:
        yield
    finally:
        await bench.operator.ask("abort")


async def left_um(bench: AgentBench, seconds: float) -> tuple[FloatArray, FloatArray]:
    """(3,) RMS left at the tool, µm, with what is in force; and with the best constant offset instead."""
    rows = np.array(await bench.operator.ask("sample", round(seconds * 1000), *SIGNALS))
    wanted = np.array([kinematics.tcp_offsets(WARM, _position(row), RADIUS_MM * 1e-3) for row in rows])
    left, constant = wanted - rows[:, 4:] * 1e3, wanted - wanted.mean(axis=0)
    return np.sqrt((left**2).mean(axis=0)), np.sqrt((constant**2).mean(axis=0))


def _position(row: FloatArray) -> FloatArray:
    return np.array([*row[:3], np.radians(row[3]), 0.0])


@asynccontextmanager
async def machine(folder: Path) -> AsyncIterator[AgentBench]:
    async with running(folder, _MACHINE) as bench:
        yield bench


async def by_errors(bench: AgentBench) -> None:
    """Put the nine errors in force, where they stay."""
    await claimed(bench, WatchdogTerms(86400.0, 0.0))
    await bench.nc.write_errors(NineErrors(tuple(WARM.tolist()), RADIUS_MM, (500.0, 500.0, 500.0)))


@asynccontextmanager
async def by_shifts(bench: AgentBench, period_s: float, slew_um_per_s: float) -> AsyncIterator[None]:
    """A gateway follows the axes by shifts, from the mean on."""
    await claimed(bench, WatchdogTerms(60.0, 0.0))
    mean = kinematics.tcp_offsets(WARM, np.array([0.0, 0.0, 80.0, 0.0, 0.0]), RADIUS_MM * 1e-3)
    await bench.nc.write_compensation((float(mean[0]), float(mean[1]), float(mean[2])))
    await bench.nc.close()
    nc = ShiftsOnly(bench.settings, SystemClock())
    config = validate(
        {
            "machine": {"name": "linuxcnc"},
            "nc": {"kind": "linuxcnc", "key_file": str(bench.settings.key_file), "period_s": period_s},
            "probing": {"sphere_radius_mm": RADIUS_MM},
            "compensation": {
                "mode": "compensate",
                "slew_um_per_s": slew_um_per_s,
                "bound_um": [500.0] * 3,
                "stale_after_s": 1e4,
            },
        }
    )
    identity = Identity(owner=7)
    link = NcLink(nc, RealClock(), LinkSettings.of(config, identity), Earlier(first_number=1), Listeners())
    nan = np.full(9, np.nan)
    link.follow(Decision(1, Phase.COMPENSATION, WARM, WARM, nan, nan, None, None, ()))
    task = asyncio.create_task(link.run())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await nc.close()


async def table(seconds: float = 20.0) -> None:
    """Print it: worst axis, µm."""
    ways = {"1 s, 1 µm/s": (1.0, 1.0), "1 s, 100 µm/s": (1.0, 100.0), "0.05 s, 100 µm/s": (0.05, 100.0)}
    for motion in MOTIONS:
        found: dict[str, float] = {}
        for way, (period_s, slew) in ways.items():
            with TemporaryDirectory() as folder:
                async with (
                    machine(Path(folder)) as bench,
                    in_motion(bench, Path(folder) / "machine" / "nc", motion),
                    by_shifts(bench, period_s, slew),
                ):
                    await asyncio.sleep(5.0)
                    found[way] = float((await left_um(bench, seconds))[0].max())
        with TemporaryDirectory() as folder:
            async with machine(Path(folder)) as bench:
                await by_errors(bench)
                async with in_motion(bench, Path(folder) / "machine" / "nc", motion):
                    left, constant = await left_um(bench, seconds)
        found |= {"constant": float(constant.max()), "servo thread": float(left.max())}
        print(motion, {way: f"{value:.3f}" for way, value in found.items()}, flush=True)


if __name__ == "__main__":
    asyncio.run(table())
