"""Days of the simulated machine's temperatures, healthy sensors."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simulators.cases import random_axes
from simulators.plant import Environment, MachineDrive, Plant, load_machine, record_drive

Array = NDArray[np.float64]
NAMES = load_machine().channels
DAY = 288


@cache
def plant_days(seed: int) -> Array:
    """(5 days, 29) temperatures in steps of 0.1 K under random loads of single axes."""
    plant = Plant(load_machine(), Environment(), seed)
    plant.advance(12 * 3600.0, MachineDrive())
    return np.round(record_drive(plant, random_axes(seed, 5 * DAY)).inputs[:, : len(NAMES)], 1)
