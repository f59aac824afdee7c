"""The sphere on the emulated machine's table, as a HAL component. Runs under the system's Python, see screen.py."""

import math
import threading
from typing import Any

import hal

from simulators.plant import Environment, MachineDrive, Plant, load

_PERIOD_S = 0.002
_LOADS = MachineDrive(speed_x=6000.0, speed_c=1200.0, spindle_speed=12000.0, coolant_on=True)
_IDLE_S = 12 * 3600.0


class Sphere:
    """Follows A and C at once: where it would be on the ideal machine, and off by the plant's thermal errors.

    The plant's time stands still but for `warm`: a cycle is short for it.

    radius_mm, height_mm: on the table. zero_mm: (3,) where the spindle's gauge point is, in machine coordinates, when
    the probe's tip is where A and C meet.
    """

    def __init__(self, radius_mm: float, height_mm: float, zero_mm: list[float], seed: int) -> None:
        self._radius, self._height, self._zero = radius_mm, height_mm, zero_mm
        self._plant = Plant(load(), Environment(), seed)
        self._plant.advance(_IDLE_S, MachineDrive())
        self._plant.zero()
        self._pins: Any = hal.component("sphere")
        for name in "ac":
            self._pins.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
        for name in "xyz":
            self._pins.newpin(f"minus-{name}", hal.HAL_FLOAT, hal.HAL_OUT)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._place()
        self._pins.ready()

    def start(self) -> None:
        """Once its pins are connected."""
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._thread.join()

    def warm(self, hours: float) -> None:
        """Let the plant work so long."""
        self._plant.advance(self._plant.time_s + hours * 3600.0, _LOADS)

    def errors(self) -> list[float]:
        """The nine true ones since the start, µm and µm/m."""
        return [float(v) for v in self._plant.errors()]

    def _run(self) -> None:
        while not self._ended.wait(_PERIOD_S):
            self._place()

    def _place(self) -> None:
        a_deg, c_deg = self._pins["a"], self._pins["c"]
        a, c = math.radians(a_deg), math.radians(c_deg)
        x, y, z = self._radius * math.cos(c), self._radius * math.sin(c), self._height
        ideal = x, y * math.cos(a) - z * math.sin(a), y * math.sin(a) + z * math.cos(a)
        off_um = self._plant.deviation_um(*ideal, a_deg, c_deg)
        for name, zero, at, off in zip("xyz", self._zero, ideal, off_um, strict=True):
            self._pins[f"minus-{name}"] = -(zero + at + float(off) * 1e-3)
