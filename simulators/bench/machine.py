"""The machine on the bench: plant, load case and control joined on one clock, seen by the devices' wires."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

from simulators.clock import SharedClock
from simulators.devices.source import ValueSource
from simulators.lumped import MachinePlant
from simulators.lumped.machine import Drive
from simulators.nc import Block, CycleSettings, EmulatedControl, Kind, LoadCase, Loads
from talc.names import THERMAL_ERRORS

SPHERE_RADIUS_MM = 200.0
"""Distance of the sphere from the C axis; as in gateway.toml. 1 µm of probing noise is 2-4 µm/m of tilt there."""
GROWTH_GAP_UM = 250.0
"""Gap at which the eddy-current sensor was mounted: the middle of its range."""
REST_S = 900.0
"""The machine rests so long at first."""
TRUTH_STEP_S = 60.0
TRUTH_COLUMNS = ("time_s", *THERMAL_ERRORS, "dx", "dy", "dz", "rx", "ry", "rz", "probing")
"""Simulated time; the nine errors; tool-to-workpiece deviation without (d) and with compensation (r), µm;
1 while the machine probes, when nothing is cut and compensation stands still."""


class BenchMachine:
    """One emulated machine.

    Parameters
    ----------
    seed: of weather, loads, sensor noise and probing noise
    clock: simulated time, read only
    hours: simulated hours that the load case must cover
    """

    def __init__(self, seed: int, clock: SharedClock, hours: float) -> None:
        self._clock = clock
        start_hour = clock.utc().hour + clock.utc().minute / 60.0
        program = _day(seed, hours, start_hour)
        self.plant = MachinePlant(seed, self._drive, SPHERE_RADIUS_MM * 1e-3, start_hour=start_hour)
        self.control = EmulatedControl(
            self.plant, clock, program, cycle=CycleSettings(radius_mm=SPHERE_RADIUS_MM), seed=seed
        )

    def temperatures(self, names: Sequence[str]) -> ValueSource:
        """A value source for a device that these sensors are wired to."""

        def values() -> list[float]:
            self.plant.advance(self._clock.monotonic())
            now = self.plant.sensors()
            return [now[name] for name in names]

        return values

    def growth(self) -> ValueSource:
        """A value source for the eddy-current sensor, µm."""

        def values() -> list[float]:
            self.plant.advance(self._clock.monotonic())
            return [GROWTH_GAP_UM + self.plant.spindle_growth_um()]

        return values

    def truth(self, time_s: float) -> list[float]:
        """One row of TRUTH_COLUMNS at a time until now."""
        self.plant.advance(time_s)
        state = self.control.nck.state(time_s)
        x, y, z, a, c = (state.positions[axis] for axis in ("X", "Y", "Z", "A", "C"))
        deviation = self.plant.tool_deviation_um(time_s, x, y, z, a, c)
        shift = self.control.nck.shift_um((x, y, z))
        left = [d - s for d, s in zip(deviation, shift, strict=True)]
        return [time_s, *map(float, self.plant.errors(time_s)), *deviation, *left, float(state.probing)]

    def _drive(self, start_s: float, end_s: float) -> Drive:
        loads = self.control.nck.mean_loads(start_s, end_s)
        return Drive(loads.x, loads.y, loads.z, loads.a, loads.c, loads.spindle, loads.coolant)


def _day(seed: int, hours: float, start_hour: float) -> LoadCase:
    """The load case, after a rest in which the reference of all later measurements is taken."""
    later = LoadCase.random(seed, (hours + 24.0) * 3600.0, start_hour=start_hour + REST_S / 3600.0)
    rest = Block(0.0, REST_S, Kind.PAUSE, Loads())
    shifted = (Block(b.start_s + REST_S, b.end_s + REST_S, b.kind, b.loads) for b in later.blocks)
    return LoadCase([rest, *shifted])


class TruthRecorder:
    """Writes what only a simulation can know, once per simulated minute, for the report."""

    def __init__(self, machine: BenchMachine, clock: SharedClock, path: Path) -> None:
        self._machine, self._clock = machine, clock
        self._path = path

    async def run(self, stopped: Callable[[], bool]) -> None:
        """Until stopped."""
        with self._path.open("w", newline="", encoding="ascii") as file:
            writer = csv.writer(file)
            writer.writerow(TRUTH_COLUMNS)
            due = 0.0
            while not stopped():
                await self._clock.sleep_until(due)
                writer.writerow([f"{v:.6g}" for v in self._machine.truth(due)])
                due += TRUTH_STEP_S
