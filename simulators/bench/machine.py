"""The machine on the bench: plant, load case and control joined on one clock, seen by the devices' wires."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

from simulators.clock import SharedClock
from simulators.devices.source import ValueSource
from simulators.nc import CycleSettings, EmulatedControl, LoadCase
from simulators.plant import MachinePlant
from simulators.plant.machine import Drive
from talc.names import THERMAL_ERRORS

SPHERE_RADIUS_MM = 200.0
"""Distance of the sphere from the C axis; as in gateway.toml. 1 µm of probing noise is 2-4 µm/m of tilt there."""
TRUTH_STEP_S = 60.0
TRUTH_COLUMNS = ("time_s", *THERMAL_ERRORS, "dx", "dy", "dz", "rx", "ry", "rz")
"""Simulated time; the nine errors; tool-to-workpiece deviation without (d) and with compensation (r), µm."""


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
        program = LoadCase.random(seed, (hours + 24.0) * 3600.0, start_hour=start_hour)
        self.plant = MachinePlant(seed, self._drive, start_hour=start_hour)
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
            return [self.plant.spindle_growth_um()]

        return values

    def truth(self, time_s: float) -> list[float]:
        """One row of TRUTH_COLUMNS at a time until now."""
        self.plant.advance(time_s)
        state = self.control.nck.state(time_s)
        x, y, z, a, c = (state.positions[axis] for axis in ("X", "Y", "Z", "A", "C"))
        deviation = self.plant.tool_deviation_um(time_s, x, y, z, a, c)
        shift = self.control.nck.shift_um((x, y, z))
        left = [d - s for d, s in zip(deviation, shift, strict=True)]
        return [time_s, *map(float, self.plant.errors(time_s)), *deviation, *left]

    def _drive(self, start_s: float, end_s: float) -> Drive:
        loads = self.control.nck.mean_loads(start_s, end_s)
        return Drive(loads.x, loads.y, loads.z, loads.a, loads.c, loads.spindle, loads.coolant)


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
