"""The machine on the bench: plant, load case and control on one clock, as the devices measure them."""

import csv
import math
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path

from simulators.devices import ValueSource
from simulators.nc import (
    Activity,
    CycleSettings,
    DayPart,
    EmulatedControl,
    FollowingTerms,
    LoadCase,
    MeanLoads,
    SimulatedClock,
)
from simulators.plant import RADIUS_MM, STEP_S, Environment, MachineDrive, Plant, load_machine
from talc.names import THERMAL_ERRORS

GROWTH_GAP_UM = 250.0
"""Gap at which the eddy-current sensor was mounted: the middle of its range."""
IDLE_S = 12 * 3600.0
"""Time switched on but idle before simulated time begins: the reference is not taken on a cold machine."""
REST_S = 900.0
"""The machine rests for this long at first."""
DEMO_TERMS = FollowingTerms(1.0, RADIUS_MM, (150.0, 150.0, 150.0), (210.0, math.hypot(210.0, 250.0)))
"""Terms of the program with which the control follows the nine errors; as gateway.toml has them."""
STEP_OF_WORK_S, WORK_S = 300.0, 120.0
"""Step of a program that rests often, and how much of it is work."""
TRUTH_STEP_S = 60.0
TRUTH_COLUMNS = ("utc_s", *THERMAL_ERRORS, "dx", "dy", "dz", "rx", "ry", "rz", "probing")
"""Simulated UTC; the nine errors; tool-to-workpiece deviation without (d) and with compensation (r), µm;
1 while the machine probes, when nothing is cut and compensation stands still."""


class BenchMachine:
    """One emulated machine.

    Parameters
    ----------
    seed: determines weather, loads, sensor noise and probing noise
    clock: simulated time, read only
    hours: simulated hours that the load case must cover
    errors: terms of its control's program for nine errors; None: it has no such program, but takes other routes
    rests: its program stops every five minutes for three, so that a probing cycle can be had in each grid step
    """

    def __init__(
        self,
        seed: int,
        clock: SimulatedClock,
        hours: float,
        errors: FollowingTerms | None = DEMO_TERMS,
        *,
        rests: bool = False,
    ) -> None:
        self._clock = clock
        self._truth: list[list[float]] = []
        self._epoch_s = clock.utc().timestamp() - clock.monotonic()
        start_hour = clock.utc().hour + clock.utc().minute / 60.0
        program = _with_rests(seed, hours) if rests else _day(seed, hours, start_hour)
        self.plant = Plant(load_machine(), Environment(), seed, start_utc=clock.utc() - timedelta(seconds=IDLE_S))
        self.plant.advance(IDLE_S, MachineDrive())
        self.plant.zero()
        cycle = CycleSettings(radius_mm=RADIUS_MM)
        self.control = EmulatedControl(self, clock, program, cycle=cycle, seed=seed, errors=errors)
        self.control.nck.advanced = self.advance  # what has passed is noted with the offsets that were in force

    def advance(self, time_s: float) -> None:
        """Advance the plant to a past or present time, with the drives of each inner step from the control."""
        while (begin := self.plant.time_s - IDLE_S) + STEP_S <= time_s:
            loads = self.control.nck.mean_loads(begin, begin + STEP_S)
            drive = MachineDrive(
                speed_x=loads.x,
                speed_y=loads.y,
                speed_z=loads.z,
                speed_a=loads.a,
                speed_c=loads.c,
                spindle_speed=loads.spindle,
                coolant_on=loads.coolant >= 0.5,
            )
            self.plant.advance(IDLE_S + begin + STEP_S, drive)
            if (begin + STEP_S) % TRUTH_STEP_S == 0.0:
                self._truth.append(self._row(begin + STEP_S))

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        """What the control's probe and tool meet; the plant's inner step determines the time resolution."""
        self.advance(time_s)
        x, y, z = (float(v) for v in self.plant.deviation_um(x_mm, y_mm, z_mm, a_deg, c_deg))
        return x, y, z

    def temperatures(self, names: Sequence[str]) -> ValueSource:
        """A value source for a device that these sensors are wired to."""

        def values() -> list[float]:
            self.advance(self._clock.monotonic())
            now = self.plant.sensors()
            return [now[name] for name in names]

        return values

    def growth(self) -> ValueSource:
        """A value source for the eddy-current sensor, µm."""

        def values() -> list[float]:
            self.advance(self._clock.monotonic())
            return [GROWTH_GAP_UM + self.plant.spindle_growth_um()]

        return values

    def truth(self) -> list[list[float]]:
        """Rows of TRUTH_COLUMNS since the last call, recorded as the plant passed them, because it keeps no past."""
        rows, self._truth = self._truth, []
        return rows

    def _row(self, time_s: float) -> list[float]:
        state = self.control.nck.state(time_s)
        x, y, z, a, c = (state.positions[axis] for axis in ("X", "Y", "Z", "A", "C"))
        deviation = [float(v) for v in self.plant.deviation_um(x, y, z, a, c)]
        shift = self.control.nck.shift_then_um(state)
        left = [d - s for d, s in zip(deviation, shift, strict=True)]
        return [self._epoch_s + time_s, *map(float, self.plant.errors()), *deviation, *left, float(state.probing)]


def _day(seed: int, hours: float, start_hour: float) -> LoadCase:
    """The load case, after a rest in which the reference of all later measurements is taken."""
    later = LoadCase.random(seed, (hours + 24.0) * 3600.0, start_hour=start_hour + REST_S / 3600.0)
    rest = DayPart(0.0, REST_S, Activity.PAUSE, MeanLoads())
    shifted = (DayPart(b.start_s + REST_S, b.end_s + REST_S, b.kind, b.loads) for b in later.blocks)
    return LoadCase([rest, *shifted])


def _with_rests(seed: int, hours: float) -> LoadCase:
    """Two minutes of work and three of rest, again and again."""
    working = LoadCase.random(seed, hours * 3600.0, nights=False)
    blocks = list[DayPart]()
    for number in range(math.ceil(hours * 3600.0 / STEP_OF_WORK_S)):
        begin = number * STEP_OF_WORK_S
        block = working.at(begin)
        blocks.append(DayPart(begin, begin + WORK_S, block.kind, block.loads))
        blocks.append(DayPart(begin + WORK_S, begin + STEP_OF_WORK_S, Activity.PAUSE, MeanLoads()))
    return LoadCase(blocks)


class TruthRecorder:
    """Writes the true errors, which only a simulation knows, once per simulated minute, for the report."""

    def __init__(self, machine: BenchMachine, clock: SimulatedClock, path: Path) -> None:
        self._machine, self._clock = machine, clock
        self._path = path

    async def run(self, stopped: Callable[[], bool]) -> None:
        """Run until stopped or cancelled; what has passed by then is written."""
        with self._path.open("w", newline="", encoding="ascii") as file:
            rows = csv.writer(file)
            rows.writerow(TRUTH_COLUMNS)

            def write() -> None:
                self._machine.advance(self._clock.monotonic())
                rows.writerows([f"{v:.12g}" for v in row] for row in self._machine.truth())

            try:
                while not stopped():
                    write()
                    await self._clock.sleep_until(self._clock.monotonic() + TRUTH_STEP_S)
            finally:
                write()
