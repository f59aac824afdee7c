"""Drives of the machine: speeds and switches, and the resulting heat and films."""

from dataclasses import dataclass

import numpy as np

from simulators.plant.body import FloatArray
from simulators.plant.joined import FAMILIES
from simulators.plant.parameters import PlantParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineDrive:
    """Mean magnitudes over the time it is applied."""

    speed_x: float = 0.0
    """mm/min"""
    speed_y: float = 0.0
    """mm/min"""
    speed_z: float = 0.0
    """mm/min"""
    speed_a: float = 0.0
    """1/min"""
    speed_c: float = 0.0
    """1/min"""
    spindle_speed: float = 0.0
    """1/min"""
    coolant_on: bool = False
    """Cutting fluid in the working space (the NC's coolant state). The cooling circuit runs whenever powered."""
    powered: bool = True


@dataclass(frozen=True, slots=True)
class HeatLoads:
    """Heat before the viscous correction, (s,) W, film factors, (f,), and whether the chiller runs (0..1)."""

    heat_W: FloatArray  # noqa: N815
    films: FloatArray
    chiller: float


def loads(parameters: PlantParameters, drive: MachineDrive) -> HeatLoads:
    """Heat laws and film factors of one drive.

    Families: flow 1 when powered; wet 1 with cutting fluid; table (|n|/1200)^0.8 and nose (|n|/18000)^0.8, the
    turbulent rotating disc.
    """
    heat = np.zeros(len(parameters.laws))
    for s, law in enumerate(parameters.laws):
        r = abs(float(getattr(drive, law.drive))) / law.at
        heat[s] = law.standby * drive.powered + law.linear * r + (law.power * r**law.exponent if r else 0.0)
    factor = dict.fromkeys(FAMILIES, 0.0)
    factor["flow"] = float(drive.powered)
    factor["wet"] = float(drive.coolant_on)
    factor["table"] = (abs(drive.speed_c) / 1200.0) ** 0.8
    factor["nose"] = (abs(drive.spindle_speed) / 18000.0) ** 0.8
    return HeatLoads(heat, np.array([factor[name] for name in FAMILIES]), float(drive.powered))
