"""The state of the real LinuxCNC before a probing cycle and after it, sampled, from many starting states.

`python -m tests.benches.linuxcnc_states [COUNT]`: COUNT states (60), drawn so that every value of every modal group is
among them, and those in which a cycle is refused before the first move. About half a minute each.
"""

import asyncio
import random
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from drivers.nc import ProbingState, RequestStatus
from simulators.linuxcnc.machine import HURRY
from tests.benches.linuxcnc_bench import AgentBench, running, until

TOOLS: Final = (
    "T99 P99 X0.5 Y-0.25 Z40 D6 ;probe\nT1 P1 Z100 D8 ;mill\nT2 P2 Z150 D8 ;long mill\nT5 P5 X2 Z17 A1 C3 D6 ;skew\n"
)
MACHINE: Final[Mapping[str, object]] = {
    **HURRY,
    "MAX_ACCELERATION": f"{HURRY['MAX_ACCELERATION']}\nOFFSET_AV_RATIO = 0.1",  # external offsets are possible
    **{"PIVOT_X": 3, "PIVOT_Y": -4, "PIVOT_Z": -5},
    **{"FEED": 300, "FIND_FEED": 2000},
}
GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "tool": (
        "",
        "T1 M6\nG43",
        "T1 M6\nG43.1 Z77",
        "T1 M6\nG43 H2",
        "T1 M6\nG43\nG43.2 H2",
        "T1 M6\nG49",
        "T5 M6\nG43",
        "T99 M6\nG43",
        "T99 M6\nG49",
        "T2 M6\nG43.1 X0.123456789 Y-7 Z-12.5 A2 C-30",
    ),
    "preselected": ("", "T2", "T1", "T0"),
    "system": (
        "G54",
        "G10 L2 P1 X11 Y-7 Z3 A1 C2 R30\nG54",
        "G10 L2 P2 X1 R-12.3456\nG55",
        "G59",
        "G10 L2 P9 X5 Y6 Z-7 A2 C3 R45\nG59.3",
        "G10 L2 P7 Z12.7\nG59.1",
    ),
    "shift": ("", "G92 X1 Y2 Z3 C4", "G92 X1 Y2\nG92.2"),
    "units": ("G21", "G20"),
    "path": ("G64", "G64 P0.0123456789 Q0.004", "G64 P0.5", "G61", "G61.1"),
    "motion": ("G80", "G0", "G1 F1"),
    "feed": ("F600", "F0.123456", "G93", "G95 F0.0625", "F123.4\nG93"),
    "distance": ("G90", "G91"),
    "plane": ("G17", "G18", "G19"),
    "arcs": ("G91.1", "G90.1"),
    "retract": ("G98", "G99"),
    "diameter": ("G8", "G7"),
    "overrides": ("M48", "M49", "M50 P0", "M51 P0", "M52 P1", "M53 P1"),
    "spindle": ("M5", "M3 S800", "M4 S1234.5", "S77", "G96 D2500 S200 M3"),
    "coolant": ("M9", "M7", "M8", "M7\nM8"),
}
"""Blocks that bring about each state of each modal group."""
PLAIN: Final = (
    "G21 G90 G17 G40 G49 G54 G94 G64 G80 G8 G91.1 G98 G97\nM48\nM52 P0\nM53 P0\nM5 M9\nS0\nF0\nG92.1\n"
    "G10 L2 P1 X0 Y0 Z0 A0 C0 R0\nG10 L2 P2 X0 R0\nG10 L2 P7 Z0\nG10 L2 P9 X0 Y0 Z0 A0 C0 R0\nT0 M6\nG49"
)
PARAMETERS: Final = (
    *("_motion_mode", "_plane", "_ccomp", "_metric", "_absolute", "_inverse_time", "_units_per_minute"),
    *("_units_per_rev", "_coord_system", "_tool_offset", "_retract_old_z", "_spindle_rpm_mode", "_ijk_absolute_mode"),
    *("_lathe_diameter_mode", "_spindle_on", "_mist", "_flood", "_speed_override", "_feed_override", "_adaptive_feed"),
    *("_feed_hold", "_feed", "_rpm", "_current_tool", "_selected_tool"),
)
NUMBERED: Final = (5210, 5211, 5213, 5216, 5220, 5221, 5230, 5241, 5250, 5381, 5383, 5390, 5400, 5403)
"""G92, coordinate systems with their rotations, and the loaded tool's offsets."""
FINAL: Final = (ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED)
_NEAR = 1e-9


def drawn(count: int, seed: int) -> list[dict[str, str]]:
    """Starting states: every value of every group as often as every other, in random company."""
    draw = random.Random(seed)
    columns = {}
    for group, values in GROUPS.items():
        column = [values[i % len(values)] for i in range(count)]
        draw.shuffle(column)
        columns[group] = column
    states = [{group: column[i] for group, column in columns.items()} for i in range(count)]
    for state in states:
        if not state["tool"] and state["preselected"] == "T0":
            state["preselected"] = ""  # to a program, an empty spindle prepared for no tool is one that is not prepared
    return states


@asynccontextmanager
async def stateful(folder: Path, **settings: object) -> AsyncIterator[AgentBench]:
    async with running(folder, {**MACHINE, **settings}, sphere=True, tools=TOOLS) as bench:
        names = [*(f"#<{name}>" for name in PARAMETERS), *(f"#{number}" for number in NUMBERED)]
        told = "".join(f"M68 E{i} Q{name}\n" for i, name in enumerate(names))
        (folder / "machine" / "nc" / "told.ngc").write_text(f"o<told> sub\n{told}o<told> endsub\nM2\n")
        for axis in "xyz":
            await bench.operator.ask("hal", "setp", f"axis.{axis}.eoffset-scale", "0.001")
            await bench.operator.ask("hal", "setp", f"axis.{axis}.eoffset-enable", "1")
        yield bench


async def bring_about(bench: AgentBench, state: Mapping[str, str]) -> None:
    for block in [*PLAIN.splitlines(), *(line for blocks in state.values() for line in blocks.splitlines())]:
        await bench.operator.ask("mdi", block)


async def sampled(bench: AgentBench) -> dict[str, Any]:
    """The state, from LinuxCNC's status and from its interpreter."""
    found: dict[str, Any] = await bench.operator.ask("modal")
    found["external"] = [await bench.operator.number("getp", f"axis.{axis}.eoffset") for axis in "xyz"]
    await bench.operator.ask("mdi", "o<told> call")
    found["interpreter"] = [
        await bench.operator.number("getp", f"motion.analog-out-{i:02}") for i in range(len(PARAMETERS) + len(NUMBERED))
    ]
    return found


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """What is not the same; numbers within a billionth."""
    return {name: (before[name], after[name]) for name in before if not _same(before[name], after[name])}


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, list):
        return len(a) == len(b) and all(map(_same, a, b))
    return bool(a == b or abs(a - b) <= _NEAR * max(1.0, abs(a)))


async def cycle(bench: AgentBench, number: int) -> RequestStatus:
    """Request a cycle, and call the safe point as a part program does; returns when both have ended."""
    await bench.nc.request_probing(number)
    await bench.pass_time(0.1)  # the real time of a busy computer shows the request later
    await bench.operator.ask("send_mdi", "o<talc_safe_point> call")

    async def over() -> bool:
        status = await bench.nc.probing_status(number)
        return status.state in FINAL and await bench.operator.sees(idle=True)

    await until(over)
    return await bench.nc.probing_status(number)


async def compared(bench: AgentBench, state: Mapping[str, str], number: int) -> tuple[RequestStatus, dict[str, Any]]:
    """How a cycle from this state ended, and what of the state is not the same afterwards."""
    await bring_about(bench, state)
    before = await sampled(bench)
    status = await cycle(bench, number)
    return status, differences(before, await sampled(bench))


async def refused(bench: AgentBench, number: int) -> dict[str, tuple[RequestStatus, bool]]:
    """In each state in which no cycle can begin: how it ended, and whether nothing moved or changed."""
    hal, found = bench.operator, {}
    for name, begin, end in (
        (
            "active transformation",
            ("hal", "setp", "motion.switchkins-type", "1"),
            ("hal", "setp", "motion.switchkins-type", "0"),
        ),
        ("unknown tool length", ("mdi", "G10 L1 P99 Z0"), ("mdi", "G10 L1 P99 Z40")),
        (
            "external offset",
            ("hal", "setp", "axis.x.eoffset-counts", "25"),
            ("hal", "setp", "axis.x.eoffset-counts", "0"),
        ),
    ):
        await bring_about(bench, {})
        await hal.ask(*begin)
        await bench.pass_time(0.5)
        before, at = await sampled(bench), (await hal.ask("state"))["position"]
        number += 1
        status = await cycle(bench, number)
        same = (await hal.ask("state"))["position"] == at and not differences(before, await sampled(bench))
        found[name] = status, same
        await hal.ask(*end)
        await bench.pass_time(0.5)
    await hal.ask("unhome")
    at = (await hal.ask("state"))["position"]
    await bench.nc.request_probing(number + 1)

    async def over() -> bool:
        return (await bench.nc.probing_status(number + 1)).state in FINAL

    await until(over)
    found["unhomed axis"] = await bench.nc.probing_status(number + 1), (await hal.ask("state"))["position"] == at
    await hal.ask("home")
    return found


async def table(count: int, seed: int = 1) -> int:
    """Print it; the number of states that were not restored, or from which no cycle was done."""
    wrong = 0
    with TemporaryDirectory() as folder:
        async with stateful(Path(folder)) as bench:
            for number, state in enumerate(drawn(count, seed), start=1):
                status, changed = await compared(bench, state, number)
                wrong += bool(changed) or status.state is not ProbingState.DONE
                blocks = "; ".join(blocks.replace("\n", ", ") for blocks in state.values() if blocks)
                print(f"{number}: {status.state.value} {status.reason} {changed or 'equal'}: {blocks}", flush=True)
            for name, (status, same) in (await refused(bench, count)).items():
                wrong += status.state is not ProbingState.REFUSED or not same
                print(f"{name}: {status.state.value}, {status.reason}; {'nothing moved' if same else 'CHANGED'}")
    print(f"{count} starting states, and those that are refused: {wrong} wrong")
    return wrong


if __name__ == "__main__":
    sys.exit(1 if asyncio.run(table(int(sys.argv[1]) if len(sys.argv) > 1 else 60)) else 0)
