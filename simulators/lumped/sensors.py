"""Temperature sensors: lag of the mounting, noise, an offset each. Quantisation is the device's business."""

import math
from collections.abc import Mapping

import numpy as np

STRUCTURE = (
    "bed_front_left", "bed_front_right", "bed_rear_left", "bed_rear_right", "column_left", "column_right", "x_slide",
    "x_nut", "a_cradle_left", "a_cradle_right", "a_drive", "c_table", "c_drive", "y_slide", "y_nut", "z_slide", "z_nut",
    "spindle_front", "spindle_rear", "spindle_motor",
)  # fmt: skip
AMBIENT = ("ambient_front", "ambient_rear", "ambient_left", "ambient_high")
SPACE = ("space_left", "space_right")
FLUIDS = ("coolant_in", "coolant_out", "cutting_fluid")
SENSORS = STRUCTURE + AMBIENT + SPACE + FLUIDS
"""The 29 temperatures of Z22: 20 structural, 4 ambient, 2 working space, 3 fluids."""

_LAG_S = dict.fromkeys(STRUCTURE, 90.0) | dict.fromkeys(AMBIENT, 240.0) | dict.fromkeys(SPACE, 180.0)
_LAG_S |= dict.fromkeys(FLUIDS, 30.0)
_NOISE_K = 0.05
_OFFSET_K = 0.15
"""Pt100 class A: ±0.15 K at 0 degC."""


class SensorModel:
    """First-order lag, constant offset and white noise of each sensor.

    Parameters
    ----------
    seed: noise is a function of seed, sensor and time step, so reading a sensor twice gives the same value
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._offset = np.random.default_rng([seed, 2]).uniform(-_OFFSET_K, _OFFSET_K, len(SENSORS))
        self._lag = np.array([_LAG_S[name] for name in SENSORS])
        self._state = np.zeros(len(SENSORS))

    def settle(self, seen: Mapping[str, float]) -> None:
        """Start in balance with what is seen, degC."""
        self._state = self._vector(seen)

    def step(self, dt_s: float, seen: Mapping[str, float]) -> None:
        """One step with the places' temperatures held, degC."""
        share = 1.0 - np.exp(-dt_s / self._lag)
        self._state = self._state + share * (self._vector(seen) - self._state)

    def values(self, step_number: int) -> dict[str, float]:
        """What each sensor shows, degC."""
        noise = np.random.default_rng([self._seed, 4, step_number]).normal(0.0, _NOISE_K, len(SENSORS))
        return dict(zip(SENSORS, (float(v) for v in self._state + self._offset + noise), strict=True))

    def _vector(self, seen: Mapping[str, float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        vector = np.array([seen[name] for name in SENSORS])
        if not np.isfinite(vector).all():
            lost = [n for n, v in zip(SENSORS, vector, strict=True) if not math.isfinite(v)]
            raise ValueError(f"no place for sensors {', '.join(lost)}")
        return vector
