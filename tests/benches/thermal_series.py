"""A record with known physics for tests of training and control: first-order responses to random heat, closed form."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ThermalSeries:
    """Inputs, true errors, measurements with 1 µm of noise."""

    names: tuple[str, ...]
    inputs: Array
    truth: Array
    measured: Array


def series(steps: int, seed: int, *, sensors: int = 12, pole: float = 0.95) -> ThermalSeries:
    """Temperatures as first-order lags of random blocks of heat, quantised to 0.1 K; each error answers two of them."""
    draw = np.random.default_rng(seed)
    heat = np.repeat(draw.uniform(0, 1, (steps // 12 + 1, sensors)), 12, axis=0)[:steps]
    temperatures = np.zeros((steps, sensors))
    memory = draw.uniform(0.9, 0.98, sensors)
    level = heat[0] * 0.0
    for k in range(steps):
        level = memory * level + (1 - memory) * 10.0 * heat[k]
        temperatures[k] = 20.0 + level
    truth = np.zeros((steps, 9))
    for e in range(9):
        drive = 1.5 * (temperatures[:, e] - 20.0) - 0.8 * (temperatures[:, e + 3] - 20.0)
        for k in range(1, steps):
            truth[k, e] = pole * truth[k - 1, e] + (1 - pole) * drive[k]
    inputs = np.round(temperatures + draw.normal(0, 0.05, temperatures.shape), 1)
    measured = truth + draw.normal(0, 0.5, truth.shape)
    return ThermalSeries(tuple(f"t{i}" for i in range(sensors)), inputs, truth, measured)


def without_ninth(made: ThermalSeries) -> ThermalSeries:
    """The same with errors counted from the first step, and the ninth zero."""
    truth = made.truth - made.truth[0]
    truth[:, 8] = 0.0
    return replace(made, truth=truth, measured=truth + made.measured - made.truth)
