"""What stands still in a probing cycle of the real LinuxCNC, and from when to when, in its own servo periods.

The agent is frozen meanwhile: only the real-time component acts. Needs Debian's linuxcnc-uspace.
"""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import NineErrors, ProbingState, WatchdogTerms
from simulators.linuxcnc.machine import HURRY
from talc import kinematics
from talc.frame import FloatArray
from tests.benches.linuxcnc_bench import AgentBench, claimed, running, until

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(30)]

WARM = np.array([2.1, 88.8, 11.3, 6.4, 21.7, 12.6, 35.0, -18.0, 24.0])
RADIUS_MM, SAFE_Z_MM = 120.0, 180.0
RUNNING = 2
SIGNALS = (
    *("talc-state", "talc-tool-z", "talc-x-cmd", "talc-y-cmd", "talc-z-cmd", "talc-a-cmd"),
    *(f"talc-{axis}-in-force" for axis in "xyz"),
)
PROGRAM = """\
G21 G90 G53 G0 X-200 Y100 Z-20 A30
T99 M6 G43 H99
M68 E9 Q1
M66 P3 L3 Q300
o<talc_safe_point> call
M68 E9 Q3
M66 P3 L4 Q300
T5 M6 G43 H5
G53 G0 X-200 Y100 A30
M68 E9 Q2
M2
"""
TOOLS = "T99 P99 Z40 D6 ;probe\nT5 P5 Z140 D6 ;mill\n"


def shift_um(tip_mm: FloatArray, a_deg: float) -> FloatArray:
    return kinematics.tcp_offsets(WARM, np.array([*tip_mm, np.radians(a_deg), 0.0]), RADIUS_MM * 1e-3)


async def marked(bench: AgentBench, mark: float) -> bool:
    return await bench.operator.number("getp", "motion.analog-out-09") == mark


async def test_offsets_stand_still_from_the_first_touch_to_the_last_and_nothing_is_taken_back(tmp_path: Path) -> None:
    settings = {**HURRY, "FEED": 60, "FIND_FEED": 2000, "SAFE_Z": SAFE_Z_MM, "SLEW": 10, "LOWER": -0.5, "BOUND": 0.5}
    async with running(tmp_path, settings, sphere=True, tools=TOOLS) as bench:
        await claimed(bench, WatchdogTerms(86400.0, 0.0))
        await bench.nc.write_errors(NineErrors(tuple(WARM.tolist()), RADIUS_MM, (500.0, 500.0, 500.0)))
        (tmp_path / "machine" / "nc" / "part.ngc").write_text(PROGRAM)
        await bench.operator.ask("run", "part.ngc")
        await until(lambda: marked(bench, 1))
        await bench.nc.request_probing(17)
        await bench.operator.ask("hal", "setp", "motion.digital-in-03", "1")
        chunks = []
        async with asyncio.timeout(300):
            while not await marked(bench, 2):
                await bench.operator.ask("freeze", "talc_agent.py")  # for less than the program would notice
                chunks.append(np.array(await bench.operator.ask("sample", 2000, *SIGNALS)))
                looked_s = await bench.operator.number("getp", "talc.seen")
                await bench.operator.ask("thaw", "talc_agent.py")

                async def looked(before_s: float = looked_s) -> bool:
                    return await bench.operator.number("getp", "talc.seen") > before_s

                await until(looked)
                waits = await marked(bench, 3)  # with the probe still, after the cycle
                chunks.append(np.array(await bench.operator.ask("sample", 100, *SIGNALS)))
                if waits:
                    await bench.operator.ask("hal", "setp", "motion.digital-in-03", "0")
        told = await bench.nc.probing_status(17)

    rows = np.vstack(chunks)
    state, out = rows[:, 0], rows[:, 6:] * 1e3
    geometry = np.array([shift_um(row[2:5] - (0, 0, row[1]), row[5]) for row in rows])
    frozen = state == RUNNING
    # Over the sphere at the first pose: there it begins, and there it ends.
    over = shift_um(np.array([RADIUS_MM, 0.0, SAFE_Z_MM]), 0.0)
    assert told.state is ProbingState.DONE
    assert told.in_force_um == pytest.approx(over, abs=1e-6)
    assert out[frozen] == pytest.approx(np.tile(over, (frozen.sum(), 1)), abs=1e-6)
    assert np.ptp(out[frozen], axis=0).max() == 0.0
    assert np.abs(geometry - over)[frozen].max() > 20.0, "the axes moved"
    # Before and after, it follows them: nothing is taken back, until the mill is longer than the probe.
    probe = ~frozen & (rows[:, 1] == 40.0)
    assert {*np.unique(state[probe])} >= {1.0, 3.0}
    assert np.abs(out - geometry)[probe].max() < 1e-3
    assert np.ptp(geometry[probe], axis=0).max() > 20.0


async def test_the_watchdog_takes_the_offsets_to_zero_in_the_middle_of_a_cycle_too(tmp_path: Path) -> None:
    async with running(tmp_path, {"SLEW": 1.0}, tools=TOOLS) as bench:
        await claimed(bench, WatchdogTerms(60.0, 1000.0))
        await bench.nc.write_compensation((40.0, -10.0, 0.0))
        await bench.nc.claim(7, WatchdogTerms(5.0, 1000.0))
        await bench.nc.request_probing(5)

        async def requested() -> bool:
            return await bench.pin("talc-request") == 5.0

        await until(requested)
        await bench.operator.ask("freeze", "talc_agent.py")
        # As the program says. The request is still the last that the agent sent, and no more beats come.
        await bench.operator.ask("mdi", "M68 E41 Q2")
        await bench.operator.ask("mdi", "M68 E40 Q5")

        async def gone() -> bool:
            return [await bench.pin(f"talc-{axis}-in-force") for axis in "xy"] == [0.0, 0.0]

        await until(gone, 60.0)
        assert await bench.pin("talc-request") == await bench.pin("talc-answers") == 5.0
        await bench.operator.ask("thaw", "talc_agent.py")
