"""Everything that can go wrong between a gateway and a real LinuxCNC that compensates, judged by every servo period.

`python -m tests.benches.linuxcnc_disturbances 200 [CONFIGURATION ...]`: the gateway's link on LinuxCNC's agent, in real
time, five times as fast as nc_disturbances. With names of CONFIGURATIONS, each of them is disturbed by the operator
too: killed and stopped gateways, emergency stops, the machine switched off, homing again, tool changes. The axes stand
still, so that every change is the compensation's.
"""

import asyncio
import logging
import random
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from drivers.agent.control import AgentControl
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from talc.frame import FloatArray
from tests.benches.cut_wire import wire_to
from tests.benches.linuxcnc_bench import AgentBench, running, until
from tests.benches.nc_disturbances import KINDS, NcSite

PACE, SLEW_UM_PER_S = 0.2, 20.0
"""The control's own slew; the gateway's is 5 µm/s."""
_IN_FORCE_MM, _LIMIT_S = 1e-4, 300.0
"""This much must be in force before anything is disturbed: an offset of zero cannot step."""
OPERATOR: Final = ("kill", "stop", "estop", "off", "home", "unhome", "tool")
CONFIGURATIONS: Final[Mapping[str, tuple[Mapping[str, object], float]]] = {
    "mm": ({}, 1.0),
    "2ms": ({"SERVO_PERIOD": 2_000_000}, 1.0),
    "inch": ({"LINEAR_UNITS": "inch", "LOWER": -0.008, "BOUND": 0.008, "LONGEST_TOOL": 200}, 25.4),
}
"""Of the machine, and mm in one of its units."""
TOOLS: Final = "T1 P1 Z20 D1\nT2 P2 X3 Z150 D1\nT3 P3 Y-40 Z90 D1\n"
_SIGNALS = ("talc-seconds", "um-x", "um-y", "um-z")
"""Offsets in µm: a record has six decimals, which in inches are 25 nm."""


@dataclass(frozen=True)
class LinuxCncDisturbed:
    """What a run found."""

    times_s: FloatArray
    """(n,) LinuxCNC's real time at each servo period that was recorded."""
    offsets_um: FloatArray
    """(n, 3) in force."""
    count: int
    disarmings: tuple[Notice, ...]
    """What a gateway said when it disarmed itself."""

    @property
    def excess_um(self) -> float:
        """How much farther an offset moved between two recorded periods than the slew allows; none: 0 or less."""
        allowed = SLEW_UM_PER_S * np.diff(self.times_s)
        return float((np.abs(np.diff(self.offsets_um, axis=0)).max(axis=1) - allowed).max())


def _writes(data: bytes) -> bool:
    return b'"write_errors"' in data


async def _by_operator(bench: AgentBench, kind: str, draw: random.Random) -> None:
    hal = bench.operator

    async def free() -> bool:
        return bool(await hal.ask("hal", "getp", "talc-errors.homing-inhibit") == "FALSE")

    match kind:
        case "estop" | "off":
            await hal.ask("estop" if kind == "estop" else "send_off")
            await until(lambda: hal.sees(on=False))
            await bench.pass_time(draw.uniform(0.0, 0.5))
            await hal.ask("switch_on")
        case "home":
            await hal.ask("hal", "setp", "talc-errors.aside", "1")
            await until(free)
            await hal.ask("home")
            await hal.ask("hal", "setp", "talc-errors.aside", "0")
        case "unhome":
            await hal.ask("unhome")
            await until(free)
            await hal.ask("home")
        case _:
            await hal.ask("mdi", f"T{draw.randrange(4)} M6 G43")


async def disturbed_linuxcnc(
    count: int, seed: int = 1, kinds: Sequence[str] = KINDS, configuration: str = "mm"
) -> LinuxCncDisturbed:
    """Run `count` disturbances in turn."""
    clock = RealClock()
    changed, unit_mm = CONFIGURATIONS[configuration]
    recorded: list[FloatArray] = []
    with TemporaryDirectory() as name:
        async with (
            running(Path(name), {"SLEW": SLEW_UM_PER_S * 1e-3 / unit_mm, **changed}, tools=TOOLS) as bench,
            wire_to(f"tcp://127.0.0.1:{bench.settings.port}") as (wire, joined),
        ):
            await bench.nc.close()
            settings = bench.settings.model_copy(update={"port": int(joined.rsplit(":", 1)[1]), "timeout_s": 2.0})
            section = {"kind": "linuxcnc", "key_file": str(settings.key_file), "port": settings.port}
            draw = random.Random(seed)
            site = NcSite(wire, section, lambda: AgentControl(settings, clock), _writes, draw, (0.1, 40.0), pace=PACE)

            async def keep() -> None:
                recorded.append(np.array(await bench.operator.ask("recorded")).reshape(-1, len(_SIGNALS)))
                await bench.operator.ask("record", *_SIGNALS)

            async def in_force() -> bool:
                now = [abs(await bench.pin(f"talc-{axis}-in-force")) for axis in "xyz"]
                return max(now) * unit_mm >= _IN_FORCE_MM

            await bench.operator.ask("hal", "loadrt", "scale", "names=um-x,um-y,um-z")
            for axis in "xyz":
                for words in (
                    *(f"addf um-{axis} servo-thread", f"setp um-{axis}.gain {unit_mm * 1e3}"),
                    *(f"net talc-{axis}-in-force => um-{axis}.in", f"net um-{axis} um-{axis}.out"),
                ):
                    await bench.operator.ask("hal", *words.split())
            await bench.operator.ask("record", *_SIGNALS)
            site.start()
            await until(in_force, _LIMIT_S)
            for number in range(count):
                if (kind := kinds[number % len(kinds)]) in KINDS:
                    await site.disturb_all(1, (kind,), clock)
                else:
                    await _by_operator(bench, kind, draw)
                    site.aim()
                    await bench.pass_time(draw.uniform(0.1, 0.6))
                    await site.keep_armed()
                if number % 20 == 19:
                    await keep()
            await site.end(stopped=True)
            await keep()
    rows = np.vstack(recorded)
    return LinuxCncDisturbed(rows[:, 0], rows[:, 1:], count, tuple(site.disarmings))


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    count, wrong = int(sys.argv[1]) if len(sys.argv) > 1 else 200, 0
    for configuration in sys.argv[2:] or [""]:
        by = (OPERATOR, configuration) if configuration else (KINDS, "mm")
        found = asyncio.run(disturbed_linuxcnc(count, 1, *by))
        passed, steps = np.diff(found.times_s), np.abs(np.diff(found.offsets_um, axis=0)).max(axis=1)
        period_s, most_um = float(np.median(passed)), np.abs(found.offsets_um).max()
        print(
            f"{configuration or 'mm'}: {found.count} disturbances, {len(found.times_s)} of "
            f"{passed.sum() / period_s:.0f} servo periods recorded, offsets up to {most_um:.1f} µm, "
            f"largest change in a period of {period_s * 1e3:.0f} ms {steps[passed < 1.5 * period_s].max():.4f} µm of "
            f"{SLEW_UM_PER_S * period_s:.4f} µm, beyond the slew {max(found.excess_um, 0.0):.4f} µm, disarmed "
            f"{len(found.disarmings)} times",
            flush=True,
        )
        for notice in found.disarmings:
            print(f"  disarmed: {notice.code} {dict(notice.values)}", flush=True)
        wrong += found.excess_um > 1e-6
    sys.exit(1 if wrong else 0)
