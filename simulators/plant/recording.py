"""Records series of inputs and errors without wires, for studies and numerics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulators.plant.body import FloatArray
from simulators.plant.drive import MachineDrive
from simulators.plant.plant import Plant

LOAD_NAMES = ("spindle_speed", "speed_X", "speed_Y", "speed_A", "speed_C", "coolant")


@dataclass(frozen=True, slots=True)
class PlantRecording:
    """Row k is the end of step k."""

    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, 29 + 1 + 6): temperatures in degC, spindle growth in µm, machine states."""
    errors: FloatArray
    """(T, 9) true errors, µm and µm/m."""


def record_drive(plant: Plant, drives: Sequence[MachineDrive], step_s: float = 300.0) -> PlantRecording:
    """Advance the plant through one drive per step, and record inputs and true errors after each."""
    start = plant.time_s
    inputs, errors = [], []
    for k, drive in enumerate(drives):
        plant.advance(start + (k + 1) * step_s, drive)
        states = (drive.spindle_speed, drive.speed_x, drive.speed_y, drive.speed_a, drive.speed_c, drive.coolant_on)
        inputs.append([*plant.sensors().values(), plant.spindle_growth_um(), *map(float, states)])
        errors.append(plant.errors())
    names = (*plant.parameters.channels, "spindle_growth", *LOAD_NAMES)
    return PlantRecording(names, np.array(inputs).reshape(-1, len(names)), np.array(errors).reshape(-1, 9))
