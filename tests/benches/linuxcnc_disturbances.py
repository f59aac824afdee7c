"""Everything that can go wrong between a gateway and a real LinuxCNC that compensates, judged by every servo period.

`python -m tests.benches.linuxcnc_disturbances 200`: the gateway's link on LinuxCNC's agent, in real time, five times as
fast as nc_disturbances. The axes stand still, so that every change is the compensation's.
"""

import asyncio
import logging
import random
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drivers.agent.control import AgentControl
from gateway.runtime.clocks import RealClock
from talc.frame import FloatArray
from tests.benches.cut_wire import wire_to
from tests.benches.linuxcnc_bench import running
from tests.benches.nc_disturbances import KINDS, NcSite

PACE, SLEW_UM_PER_S = 0.2, 20.0
"""The control's own slew; the gateway's is 5 µm/s."""
_MOST_PERIODS = 2_000
"""The most servo periods of one request to LinuxCNC's operator."""
_IN_FORCE_MM, _LIMIT_S = 1e-4, 300.0
"""This much must be in force before anything is disturbed: an offset of zero cannot step."""
_SIGNALS = ("talc-seconds", "talc-x-in-force", "talc-y-in-force", "talc-z-in-force")


@dataclass(frozen=True)
class LinuxCncDisturbed:
    """What a run found."""

    times_s: FloatArray
    """(n,) LinuxCNC's real time at each servo period that was recorded."""
    offsets_um: FloatArray
    """(n, 3) in force."""
    count: int
    disarmed: int

    @property
    def excess_um(self) -> float:
        """How much farther an offset moved between two recorded periods than the slew allows; none: 0 or less."""
        allowed = SLEW_UM_PER_S * np.diff(self.times_s)
        return float((np.abs(np.diff(self.offsets_um, axis=0)).max(axis=1) - allowed).max())


def _writes(data: bytes) -> bool:
    return b'"write_errors"' in data


async def disturbed_linuxcnc(count: int, seed: int = 1) -> LinuxCncDisturbed:
    """Run `count` disturbances in turn."""
    clock, ended = RealClock(), asyncio.Event()
    with TemporaryDirectory() as name:
        folder = Path(name)
        async with (
            running(folder, {"SLEW": SLEW_UM_PER_S * 1e-3}) as bench,
            wire_to(f"tcp://127.0.0.1:{bench.settings.port}") as (wire, joined),
        ):
            await bench.nc.close()
            settings = bench.settings.model_copy(update={"port": int(joined.rsplit(":", 1)[1]), "timeout_s": 2.0})
            section = {"kind": "linuxcnc", "key_file": str(settings.key_file), "port": settings.port}
            draw = random.Random(seed)
            site = NcSite(wire, section, lambda: AgentControl(settings, clock), _writes, draw, (0.1, 40.0), pace=PACE)

            recorded: list[list[float]] = []

            async def record() -> None:
                while not ended.is_set():
                    recorded.extend(await bench.operator.ask("sample", _MOST_PERIODS, *_SIGNALS))

            recording = asyncio.create_task(record())
            try:
                site.start()
                async with asyncio.timeout(_LIMIT_S):
                    while not recorded or max(map(abs, recorded[-1][1:])) < _IN_FORCE_MM:
                        await asyncio.sleep(0.1)
                await site.disturb_all(count, KINDS, clock)
                await site.end(stopped=True)
            finally:
                ended.set()
                await recording
    rows = np.array(recorded)
    return LinuxCncDisturbed(rows[:, 0], rows[:, 1:] * 1e3, count, site.disarmed)


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    found = asyncio.run(disturbed_linuxcnc(int(sys.argv[1]) if len(sys.argv) > 1 else 200))
    passed = found.times_s[-1] - found.times_s[0]
    print(
        f"{found.count} disturbances, {len(found.times_s)} of {passed * 1e3:.0f} servo periods recorded, offsets up to "
        f"{np.abs(found.offsets_um).max():.1f} µm, largest change in a period "
        f"{np.abs(np.diff(found.offsets_um, axis=0))[np.diff(found.times_s) < 0.0015].max():.4f} µm, "
        f"beyond the slew {max(found.excess_um, 0.0):.4f} µm, disarmed {found.disarmed} times"
    )
    sys.exit(0 if found.excess_um <= 1e-6 else 1)
