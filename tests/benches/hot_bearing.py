"""A spindle's bearing and its neighbours, healthy or not: temperatures by a matrix exponential.

Only the bearing is near the heat, as on a machine with one sensor in the spindle. Heat grows with the square of the
speed.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]
BODIES: Final = ("bearing", "head", "column", "bed", "hall")
NAMES: Final = (*BODIES, "spindle_speed")
DAY: Final = 288
_CAPACITY = np.array([4e3, 6e4, 2e5, 4e5])
"""J/K of the bodies; the hall is given."""
_BETWEEN = {("bearing", "head"): 1.0, ("head", "column"): 10.0, ("column", "bed"): 15.0}
_TO_HALL = np.array([2.0, 40.0, 60.0, 120.0])
"""W/K"""
_FULL_W = 60.0
"""Friction of the bearing at the highest speed."""


def bodies(speed: Array, seed: int, friction: Array | float = 1.0) -> Array:
    """(T, 6) temperatures of the bodies and of the hall, degC, and the speed (T,), 1/min, at 5 min.

    friction: factor of the bearing's heat, of all or of each step
    """
    conduction = np.diag(_TO_HALL)
    for (one, other), flow in _BETWEEN.items():
        i, j = BODIES.index(one), BODIES.index(other)
        conduction[[i, j], [i, j]] += flow
        conduction[i, j] -= flow
        conduction[j, i] -= flow
    rates = np.zeros((6, 6))  # of the four bodies, the bearing's heat and the hall
    rates[:4, :4] = -conduction / _CAPACITY[:, None]
    rates[0, 4], rates[:4, 5] = 1.0 / _CAPACITY[0], _TO_HALL / _CAPACITY
    step = expm(rates * 300.0)
    draw, k = np.random.default_rng(seed), np.arange(len(speed))
    weather = np.cumsum(draw.normal(0.0, 0.05, len(speed)))
    hall = 20.0 + 2.0 * np.sin(2.0 * np.pi * k / DAY) + weather
    heat = np.broadcast_to(friction, speed.shape) * _FULL_W * (speed / 12000.0) ** 2
    now, found = np.full(4, hall[0]), np.empty((len(speed), 5))
    for row in range(len(speed)):
        now = (step @ np.concatenate([now, [heat[row], hall[row]]]))[:4]
        found[row] = [*now, hall[row]]
    noisy = np.round(found + draw.normal(0.0, 0.03, found.shape), 1)
    return np.column_stack([noisy, speed])


def work(seed: int, days: int, most: float = 8000.0) -> Array:
    """(T,) a new speed every two hours, or none."""
    draw = np.random.default_rng(seed)
    return np.repeat(most * draw.random(12 * days) * (draw.random(12 * days) < 0.7), 24)
