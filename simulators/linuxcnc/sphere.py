"""The sphere on the emulated machine's table, as a HAL component. Runs under the system's Python, see screen.py."""

import threading
from collections.abc import Sequence
from typing import Any

import hal

from simulators.linuxcnc.chain import centre_mm

_PERIOD_S = 0.002
_NEAR_MM = 0.5
"""The touch is over when the probe is this far away from the sphere."""


class Sphere:
    """Follows A and C, and is off by the thermal errors that `deform` set last. Its pins show the A and C it follows.

    radius_mm, height_mm: on the table. zero_mm: (3,) where the spindle's gauge point is, in machine coordinates, when
    the probe's tip is where A and C meet.
    """

    def __init__(self, radius_mm: float, height_mm: float, zero_mm: Sequence[float]) -> None:
        self._radius, self._height, self._zero = radius_mm, height_mm, zero_mm
        self._errors: tuple[float, ...] = (0.0,) * 9
        self._play_mm, self._lifted, self._near = 0.0, False, False
        self._pins: Any = hal.component("sphere")
        for name in ("a", "c", "distance", "ball"):
            self._pins.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
        for name in ("minus-x", "minus-y", "minus-z", "placed-a", "placed-c"):
            self._pins.newpin(name, hal.HAL_FLOAT, hal.HAL_OUT)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._place()
        self._pins.ready()

    def start(self) -> None:
        """Start the sphere, once its pins are connected."""
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._thread.join()

    def deform(self, errors: Sequence[float]) -> None:
        """errors: nine, µm and µm/m, ER0T at the sphere's radius."""
        self._errors = tuple(errors)

    def loosen(self, play_um: float) -> None:
        """Loosen the sphere: from one touch to the next it is lifted by this much, or falls back; 0: it is fixed."""
        self._play_mm = play_um * 1e-3

    def _run(self) -> None:
        while not self._ended.wait(_PERIOD_S):
            self._place()

    def _place(self) -> None:
        near = self._pins["distance"] < self._pins["ball"] + _NEAR_MM
        self._lifted ^= self._near and not near
        self._near = near
        a, c = self._pins["a"], self._pins["c"]
        centre = centre_mm(self._errors, a, c, self._radius, self._height)
        for name, zero, at in zip("xyz", self._zero, centre, strict=True):
            self._pins[f"minus-{name}"] = -(zero + at + (self._play_mm if name == "z" and self._lifted else 0.0))
        self._pins["placed-a"], self._pins["placed-c"] = a, c
