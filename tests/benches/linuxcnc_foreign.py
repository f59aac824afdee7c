"""What a probing cycle of the real LinuxCNC has not commanded, in the middle of it: void result, safe probe.

`python -m tests.benches.linuxcnc_foreign [COUNT] [SEED]`: COUNT cycles (100), each disturbed once, at a moment and in a
way drawn from the seed, and judged by every servo period. A quarter of a minute each.
"""

import asyncio
import random
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from drivers.nc import ProbingState, RequestStatus
from simulators.linuxcnc.chain import centre_mm
from simulators.linuxcnc.machine import HURRY, MANUAL
from talc.frame import FloatArray
from tests.benches.linuxcnc_bench import AgentBench, running, until

LENGTH_MM, SAFE_MM, BALL_MM, RADIUS_MM, HEIGHT_MM = 40.0, 200.0, 13.0, 120.0, 80.0
TOOLS: Final = f"T99 P99 Z{LENGTH_MM:g} D6 ;probe\nT1 P1 Z100 D8 ;mill\n"
ACCELERATION_MM_PER_S2, OFFSETS_SHARE, APPROACH_MM_PER_S = 20000, 0.1, 100.0
MACHINE: Final = {
    **HURRY,
    **dict.fromkeys(("MAX_LINEAR_ACCELERATION", "MAX_ANGULAR_ACCELERATION"), ACCELERATION_MM_PER_S2),
    "MAX_ACCELERATION": f"{ACCELERATION_MM_PER_S2}\nOFFSET_AV_RATIO = {OFFSETS_SHARE}",  # external offsets are possible
    **{"FEED": 300, "FIND_FEED": 2000, "APPROACH_FEED": 60.0 * APPROACH_MM_PER_S},
}
SIGNALS: Final = ("x-drive", "y-drive", "z-drive", "a-drive", "c-drive", "sphere-size", "ceiling-at")
DEEP_MM: Final = APPROACH_MM_PER_S**2 / (ACCELERATION_MM_PER_S2 * (1.0 - OFFSETS_SHARE)) + APPROACH_MM_PER_S * 0.004
"""How far the stylus gives way: the way to stop from APPROACH_FEED, as LinuxCNC brakes with half of the acceleration
where it may blend moves, and what it takes four servo periods to notice it."""
MORE_MM = 3.5
STANDS_MM: Final = 1.5e-6
"""One in the last of a record's six decimals."""
CEILING_MM, NO_CEILING_MM = 5.0, 1e6
"""Over the spindle, which is lower than at SAFE_Z: whatever goes up meets it."""
AUTO: Final = 2
BLOCKS: Final = (
    *("G53 G1 F2000 X[#<_abs_x> + 5]", "G53 G1 F2000 Y[#<_abs_y> - 5]", "G53 G1 F600 C[#<_abs_c> + 0.01]"),
    *("G91", "G20", "G55", "G92 X1", "G43.1 Z1", "G7", "G10 L2 P9 X1"),
)
"""Executed between two blocks of the cycle, as LinuxCNC may do with one that arrives at the wrong moment."""
QUEUED: Final = ("G0 X5", "G91", "G20", "G55", "G43.1 Z1", "M3 S500")
"""Commanded in MDI meanwhile: LinuxCNC keeps it for after the cycle."""
KINDS: Final = (
    *("block", "mdi", "mode", "stop", "estop", "off", "limit", "travel", "transformation", "contact", "probe"),
    *("may-start", "ceiling", "hand", "jog", "interpreter"),
)
STOPS: Final = ("mode", "stop", "estop", "off", "limit", "travel", "may-start")
"""After these LinuxCNC itself has stopped the program, as after a contact in a rapid move, or when it finds itself in
another kind of motion after a jog: the machine stands until the operator retracts."""
SET: Final = {
    "travel": ("setp", "ini.z.max_limit", "150"),
    "may-start": ("setp", "talc.may-start", "0"),
    "transformation": ("setp", "motion.switchkins-type", "1"),
    "probe": ("sets", "probe-dead", "1"),
    "contact": ("sets", "sphere-size", str(BALL_MM + MORE_MM)),
}
BUTTONS: Final = {"stop": "send_abort", "estop": "estop", "off": "send_off"}
ERROR: Final = 99
"""On analog input 20: an error of the interpreter instead of a block."""
FINAL: Final = (ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED)


@dataclass(frozen=True)
class Disturbed:
    """One cycle."""

    kind: str
    status: RequestStatus
    deepest_mm: float
    """How far the tip was in the sphere at most, or the spindle beyond the ceiling."""
    up_mm: float
    """Height of the tip at the end; SAFE_MM is safe."""
    moved_mm: float
    """After a stop: how far any axis moved by itself. Otherwise 0."""
    sideways_mm: float
    """During the retract: how far the tip moved in any other way than up."""

    @property
    def safe(self) -> bool:
        void = self.status.state is ProbingState.FAILED and self.status.centres_mm is None
        still = max(self.moved_mm, self.sideways_mm) <= STANDS_MM
        return void and still and self.deepest_mm <= DEEP_MM and self.up_mm >= SAFE_MM - STANDS_MM


@asynccontextmanager
async def disturbable(folder: Path, **settings: object) -> AsyncIterator[AgentBench]:
    """Beside the sphere, the cycle executes the block whose number is on analog input 20, once."""
    async with running(folder, {**MACHINE, **settings}, sphere=True, tools=TOOLS) as bench:
        nc = folder / "machine" / "nc"
        choice = "\n".join(
            f"o{700 + n} if [#<_hal[motion.analog-in-20]> EQ {n}]\n{block}\n#<_foreign> = 1\no{700 + n} endif"
            for n, block in enumerate(BLOCKS, start=1)
        )
        (nc / "foreign.ngc").write_text(
            "o<foreign> sub\no800 if [#<_hal[motion.analog-in-20]> EQ 0]\n#<_foreign> = 0\no800 endif\n"
            f"o801 if [#<_foreign> EQ 0]\n{choice}\no801 endif\n"
            f"o802 if [#<_hal[motion.analog-in-20]> EQ {ERROR}]\nG1 X[1 / 0]\no802 endif\no<foreign> endsub\nM2\n"
        )
        near = (nc / "talc_near.ngc").read_text()
        (nc / "talc_near.ngc").write_text(near.replace("o<talc_check> call\n", "o<foreign> call\no<talc_check> call\n"))
        for words in (
            *("newsig sphere-size float", f"sets sphere-size {BALL_MM}", "linkps sphere-touch.in1 sphere-size"),
            *("loadrt or2 names=felt-or-dead,felt-or-hit", "loadrt wcomp names=ceiling", "net z-drive => ceiling.in"),
            *("net ceiling-at ceiling.min", f"sets ceiling-at {NO_CEILING_MM}"),
            *("setp ceiling.max 1e9", "unlinkp motion.probe-input"),
            *("net sphere-felt => felt-or-dead.in0", "net probe-dead => felt-or-dead.in1 talc.probe-error"),
            *("net felt-so-far felt-or-dead.out => felt-or-hit.in0", "net ceiling-hit ceiling.out => felt-or-hit.in1"),
            *("net probe-input felt-or-hit.out => motion.probe-input", "addf felt-or-dead servo-thread"),
            *("addf ceiling servo-thread", "addf felt-or-hit servo-thread"),
            *("setp axis.x.eoffset-scale 0.001", "setp axis.x.eoffset-enable 1"),
        ):
            await bench.operator.ask("hal", *words.split())
        await bench.operator.ask("hal", "setp", "talc.may-start", "1")
        yield bench


async def _disturb(bench: AgentBench, kind: str, draw: random.Random) -> None:
    hal = bench.operator
    match kind:
        case "ceiling":
            await until(lambda: _goes_down(bench))
            await lower_ceiling(bench)
        case "hand":
            await _turn_wheel(bench, draw.choice((-1, 1)) * 20)
        case "block" | "G43.1 Z1" | "interpreter":
            number = 1 + (BLOCKS.index(kind) if kind in BLOCKS else draw.randrange(len(BLOCKS)))
            await hal.ask("hal", "setp", "motion.analog-in-20", str(ERROR if kind == "interpreter" else number))
        case "jog":
            await until(lambda: _jogs(bench, draw.choice((-2.0, 2.0))), 60.0)
        case "mdi":
            await hal.ask("send_mdi", draw.choice(QUEUED))
        case "mode":
            await hal.ask("send_mode", draw.choice((MANUAL, AUTO)))
        case "stop" | "estop" | "off":
            await hal.ask(BUTTONS[kind])
        case "limit":
            await hal.ask("hal", "setp", f"joint.{draw.randrange(5)}.pos-lim-sw-in", "1")
        case _:
            await hal.ask("hal", *SET[kind])


async def _goes_down(bench: AgentBench) -> bool:
    """And is low. On its way up, it could be above the ceiling before that comes, on a busy computer."""
    before_mm = await bench.operator.number("gets", "z-drive")
    at_mm = await bench.operator.number("gets", "z-drive")
    return at_mm < min(before_mm - STANDS_MM, LENGTH_MM + SAFE_MM - 4.0 * CEILING_MM)


async def _jogs(bench: AgentBench, speed: float) -> bool:
    """Whether LinuxCNC has left the program's kind of motion for the jog. Within a move it refuses one."""
    await bench.operator.ask("send_jog", speed, 0.02)
    return bool(await bench.operator.ask("hal", "getp", "motion.coord-mode") == "FALSE")


async def _turn_wheel(bench: AgentBench, counts: int) -> None:
    """Of an external offset, thousandths of a millimetre, and back again."""
    await bench.operator.ask("hal", "setp", "axis.x.eoffset-counts", str(counts))
    await bench.pass_time(0.2)
    await bench.operator.ask("hal", "setp", "axis.x.eoffset-counts", "0")


async def lower_ceiling(bench: AgentBench) -> None:
    at_mm = await bench.operator.number("gets", "z-drive") + CEILING_MM
    await bench.operator.ask("hal", "sets", "ceiling-at", str(at_mm))


async def allow(bench: AgentBench) -> None:
    """The door is closed and the key turned, by somebody who has looked."""
    await bench.operator.ask("hal", "setp", "talc.may-start", "0")
    await bench.pass_time(0.5)
    await bench.operator.ask("hal", "setp", "talc.may-start", "1")


async def _mend(bench: AgentBench) -> None:
    """What the operator does afterwards, but for the retract."""
    hal = bench.operator
    await hal.ask("hal", "setp", "motion.analog-in-20", "0")
    await hal.ask("hal", "setp", "motion.switchkins-type", "0")
    await hal.ask("hal", "setp", "ini.z.max_limit", "300")
    await hal.ask("hal", "sets", "ceiling-at", str(NO_CEILING_MM))
    await hal.ask("hal", "sets", "probe-dead", "0")
    await allow(bench)
    for joint in range(5):
        await hal.ask("hal", "setp", f"joint.{joint}.pos-lim-sw-in", "0")
    if not await hal.sees(on=True):
        await hal.ask("switch_on")


async def disturbed(bench: AgentBench, kind: str, number: int, draw: random.Random) -> Disturbed:
    """One cycle with one disturbance. Raises AssertionError if the cycle was over before it."""
    hal = bench.operator

    async def in_state(*states: ProbingState) -> bool:
        return (await bench.nc.probing_status(number)).state in states

    async def at_rest() -> bool:
        return bool((await hal.ask("state"))["idle"])

    await hal.ask("record", *SIGNALS)
    await bench.nc.request_probing(number)
    await until(lambda: in_state(ProbingState.RUNNING, *FINAL))
    await bench.pass_time(draw.uniform(0.0, 6.0))
    assert await in_state(ProbingState.RUNNING), await bench.nc.probing_status(number)
    before = np.array(await hal.ask("recorded"))
    await hal.ask("record", *SIGNALS)
    await _disturb(bench, kind, draw)
    await until(lambda: in_state(*FINAL))
    await until(at_rest)
    rows = np.array(await hal.ask("recorded"))
    status = await bench.nc.probing_status(number)
    stands, low = rows[-1], rows[-1, 2] - LENGTH_MM < SAFE_MM - STANDS_MM
    stopped = kind in STOPS or status.code == "stopped" or (kind == "jog" and low)
    await hal.ask("record", *SIGNALS)
    await bench.pass_time(0.3)
    await hal.ask("hal", "sets", "sphere-size", str(BALL_MM))
    await _mend(bench)
    await bench.pass_time(0.2)
    still = np.array(await hal.ask("recorded"))
    moved = float(np.abs(still - stands)[:, :5].max()) if stopped else 0.0
    sideways = 0.0
    if stopped:
        await hal.ask("record", *SIGNALS)
        await hal.ask("mdi", "o<talc_retract> call")
        up = np.array(await hal.ask("recorded"))
        sideways = float(max(np.ptp(up[:, [0, 1, 3, 4]], axis=0).max(), -np.diff(up[:, 2]).min(initial=0.0)))
        rows = np.vstack([rows, still, up])
    deepest = max(_deepest(rows), _deepest(before), beyond_ceiling_mm(rows))
    await hal.ask("mdi", "G21 G90 G54 G94 G8 G92.1 G49 G80 M5")
    await hal.ask("mdi", "T0 M6")
    await hal.ask("send_mode", MANUAL)
    await until(lambda: hal.sees(mode=MANUAL, idle=True))
    return Disturbed(kind, status, float(deepest), float(rows[-1, 2]) - LENGTH_MM, moved, sideways)


def distances(rows: FloatArray) -> FloatArray:
    """Of the probe's tip from the sphere's centre in each servo period, mm."""
    tip = rows[:, :3] - (0.0, 0.0, LENGTH_MM)
    centres = np.array([centre_mm([0.0] * 9, a, c, RADIUS_MM, HEIGHT_MM) for a, c in rows[:, 3:5]])
    distances: FloatArray = np.linalg.norm(tip - centres, axis=1)
    return distances


def beyond_ceiling_mm(rows: FloatArray) -> float:
    """How far the spindle went after it had met the ceiling; it may have been higher when that came."""
    under = rows[rows[:, 6] < NO_CEILING_MM]
    return float(under[:, 2].max() - max(under[0, 2], under[0, 6])) if len(under) else -np.inf


def _deepest(rows: FloatArray) -> float:
    """In whatever is touched: it may grow, and the probe be within it already; mm.

    Where the probe has been since it last stood still, nothing stands in its way: at a contact it goes back there, and
    that is towards the sphere if this has grown around a probe on its way out.
    """
    found, size = distances(rows), rows[:, 5]
    if not (size > size[0]).any():
        return float(size[0] - found.min())
    grown = int(np.argmax(size > size[0]))
    stands = np.flatnonzero(np.ptp([rows[:grown, :3], rows[1 : grown + 1, :3]], axis=0).max(axis=1) == 0.0)
    been = found[stands[-1] if len(stands) else 0 : grown + 1].min()
    return float(max(min(size[grown], been) - found[grown:].min(), size[0] - found[: grown + 1].min()))


async def run(count: int, seed: int, kinds: tuple[str, ...] = KINDS) -> list[Disturbed]:
    """Disturb as many cycles, each kind in turn."""
    draw, found = random.Random(seed), []
    with TemporaryDirectory() as folder:
        async with disturbable(Path(folder)) as bench:
            for number in range(1, count + 1):
                one = await disturbed(bench, kinds[number % len(kinds)], number, draw)
                found.append(one)
                print(number, one.kind, "safe" if one.safe else "NOT SAFE", one, flush=True)
    return found


if __name__ == "__main__":
    arguments = [int(v) for v in sys.argv[1:]]
    results = asyncio.run(run(arguments[0] if arguments else 100, arguments[1] if len(arguments) > 1 else 1))
    safe = sum(one.safe for one in results)
    print(f"{safe} of {len(results)}: void result and safe retract")
    sys.exit(0 if safe == len(results) else 1)
