"""The emulated control as a separate program: a simple machine in real time, and the lines it prints while it runs."""

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from simulators.nc.control import EmulatedControl
from simulators.nc.cycle import CycleSettings, CycleState, ReasonCode
from simulators.nc.nck import R_ANSWERS, R_DRY_RUN, R_REASON, R_REQUEST, R_STATE, Nck
from simulators.nc.program import Activity, DayPart, LoadCase, MeanLoads
from simulators.nc.variables import COOLANT, DRIVES_ON, PROBE_IN_SPINDLE
from simulators.nc.watchdog import R_OWNER, R_SILENCE, R_WATCH, WatchState

GROWTH_UM = (0.0, 4.0, 6.0)
"""How far the table has moved in X, Y, Z once it is warm: more than the probing noise, but rarely so much at once
that a measurement needs confirmation."""
REFERENCE_CYCLES = 5
"""This many probing cycles end before the table moves: a gateway's reference, [probing] reference_cycles."""
_REST_S, _WORK_S, _PARTS = 50.0, 10.0, 10000
"""The machine alternately rests and works, this many times, a week; then it rests. It is probed while it rests."""
WORK = MeanLoads(x=1200.0, y=900.0, z=400.0, a=0.5, c=2.0, spindle=8000.0, coolant=1.0)
LOOK_S = 0.1
TOLD_UM = 0.5
"""Smallest change of an offset that is reported; zero is always reported."""


class OwnTime:
    """Seconds since it was made, at the speed of this computer's clock."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()

    def monotonic(self) -> float:
        return time.monotonic() - self._began_s

    def utc(self) -> datetime:
        return datetime.now(UTC)

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(monotonic_s - self.monotonic())


class GrowingTable:
    """A machine that stands still until its reference has been taken; then its table moves by GROWTH_UM.

    It moves as a first-order lag with the time constant `warm_s`, whatever the machine does.
    """

    def __init__(self, warm_s: float) -> None:
        self._warm_s = warm_s
        self.cycles: list[tuple[float, float]] = []
        """Start and end of each probing cycle that is over; the control's own list."""
        self.dry: Mapping[float, float] = {}
        """By the start of each dry run, which is no measurement; the control's own."""

    def tool_deviation_um(self, time_s: float, *_: float) -> tuple[float, float, float]:
        done = [end for begin, end in self.cycles if begin not in self.dry]
        if len(done) < REFERENCE_CYCLES:
            return 0.0, 0.0, 0.0
        part = -math.expm1(-max(0.0, time_s - done[REFERENCE_CYCLES - 1]) / self._warm_s)
        x, y, z = (part * growth for growth in GROWTH_UM)
        return x, y, z


class ControlTold:
    """What has happened at the control since the last call, in plain words."""

    def __init__(self) -> None:
        self._owner, self._watch = 0.0, 0.0
        self._request, self._cycle = 0.0, (0, CycleState.IDLE)
        self._shift = (0.0, 0.0, 0.0)

    def news(self, nck: Nck, now_s: float) -> list[str]:
        """One line for each change. nck: as advanced until `now_s`."""
        return [*self._of_the_claim(nck), *self._of_probing(nck), *self._of_the_offsets(nck, now_s)]

    def _of_the_claim(self, nck: Nck) -> list[str]:
        lines = []
        owner, watch = nck.r[R_OWNER], nck.r[R_WATCH]
        if owner != self._owner:
            lines.append(f"claimed by gateway {owner:.0f} (R93)" if owner else f"released by gateway {self._owner:.0f}")
        if watch != self._watch and watch == WatchState.ALIVE:
            lines.append("the watchdog receives the gateway's beat (R96 = 1): offsets may be written")
        elif watch != self._watch and watch == WatchState.SILENT:
            why = f"no beat for {nck.r[R_SILENCE]:g} s" if owner else "nobody has claimed the control"
            lines.append(f"the watchdog receives nothing (R96 = 2), {why}: it takes the offsets back")
        self._owner, self._watch = owner, watch
        return lines

    def _of_probing(self, nck: Nck) -> list[str]:
        lines = []
        (before, was), now = self._cycle, (int(nck.r[R_ANSWERS]), CycleState(int(nck.r[R_STATE])))
        if now[0] != before and was in (CycleState.ACCEPTED, CycleState.RUNNING):
            lines.append(f"probing cycle {before} has ended")  # and the next one was requested at once
        if nck.r[R_REQUEST] != self._request:
            dry = f", a dry run {nck.r[R_DRY_RUN]:g} mm higher (R63)" if nck.r[R_DRY_RUN] > 0 else ""
            lines.append(f"probing cycle {nck.r[R_REQUEST]:.0f} is requested (R60){dry}")
        if now != (before, was):
            reason = ReasonCode(int(nck.r[R_REASON]))
            why = f": {reason.name.lower().replace('_', ' ')} (R66 = {reason.value})" if reason else ""
            lines.append(f"probing cycle {now[0]} is {now[1].name.lower()} (R65 = {now[1].value}){why}")
        self._request, self._cycle = nck.r[R_REQUEST], now
        return lines

    def _of_the_offsets(self, nck: Nck, now_s: float) -> list[str]:
        positions = nck.state(now_s).positions
        shift = nck.shift_um((positions["X"], positions["Y"], positions["Z"]))
        change = max(abs(new - old) for new, old in zip(shift, self._shift, strict=True))
        if change < TOLD_UM and (any(shift) or not any(self._shift)):
            return []
        self._shift = shift
        x, y, z = shift
        return [f"the tool is shifted by X {x:+.1f}, Y {y:+.1f}, Z {z:+.1f} µm"]


def lone_control(clock: OwnTime, cycle: CycleSettings, warm_s: float, port: int) -> EmulatedControl:
    """The control of a machine whose table grows, and which alternately rests and works.

    warm_s: time constant of the growth, s; port: 0 takes a free one
    """
    turn_s, parts = _REST_S + _WORK_S, list[DayPart]()
    for start_s in (k * turn_s for k in range(_PARTS)):
        parts.append(DayPart(start_s, start_s + _REST_S, Activity.PAUSE, MeanLoads()))
        parts.append(DayPart(start_s + _REST_S, start_s + turn_s, Activity.FINISHING, WORK))
    parts.append(DayPart(_PARTS * turn_s, (_PARTS + 1) * turn_s, Activity.PAUSE, MeanLoads()))
    table = GrowingTable(warm_s)
    control = EmulatedControl(table, clock, LoadCase(parts), cycle=cycle, port=port)
    table.cycles, table.dry = control.nck.cycle.ended, control.nck.cycle.raised_mm
    return control


def lines_for(url: str, cycle: CycleSettings) -> str:
    """What a gateway's configuration says to reach that control: [nc], and the sphere in [probing]."""
    return f"""[nc]
kind = "sinumerik"
url = "{url}"
security = "none"
[nc.nodes]
probe_in_spindle = "{PROBE_IN_SPINDLE}"
drives_on = "{DRIVES_ON}"
[nc.states.coolant]
path = "{COOLANT}"

[probing]
sphere_radius_mm = {cycle.radius_mm!r}
sphere_height_mm = {cycle.height_mm!r}
poses_deg = {[list(pose) for pose in cycle.poses_deg]}"""


async def run_alone(
    cycle: CycleSettings, warm_s: float, port: int, told: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run until `stop`; `told` gets the lines of the configuration first, then what happens.

    Raises OSError if the port is taken.
    """
    clock = OwnTime()
    control = lone_control(clock, cycle, warm_s, port)
    url, seen = await control.start(), ControlTold()
    try:
        told(lines_for(url, cycle))
        told(f"# ready; the table moves after {REFERENCE_CYCLES} probing cycles; Ctrl-C ends it")
        while not stop.is_set():
            now_s = control.now()
            for line in seen.news(control.nck, now_s):
                told(f"# {now_s:8.1f} s  {line}")
            try:
                await asyncio.wait_for(stop.wait(), LOOK_S)
            except TimeoutError:
                continue
    finally:
        await control.stop()
    told("# ended")
