"""Deviations of the tool from where it should be, without and with compensation."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gateway.reporting.data import ReportData
from talc.frame import BoolArray, FloatArray
from talc.kinematics import tcp_offsets

_POSITIONS = 4
"""Thermal errors that are positions of an axis come first: each shifts the tool by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolCourse:
    """Deviations between tool and workpiece, X Y Z, µm, oldest first."""

    time_s: FloatArray
    """(m,) since the first frame."""
    before: FloatArray
    """(m, 3) without compensation."""
    after: FloatArray
    """(m, 3) with compensation."""
    basis: Literal["simulated", "measured"]
    """What they are made of."""
    noise: float
    """Standard uncertainty of a coordinate of one measurement, µm; NaN: unknown."""

    def between(self, begin_s: float, end_s: float) -> BoolArray:
        """(m,) which of them are in that time."""
        return (self.time_s >= begin_s) & (self.time_s < end_s)


def at_tool(data: ReportData) -> ToolCourse | None:
    """Since the first frame; None when it cannot be known: of a recording, or before the first measurement."""
    noises = np.empty(0) if data.noise is None else data.noise[:_POSITIONS]
    noise = max(noises[np.isfinite(noises)].tolist(), default=float("nan"))
    if data.truth is not None:
        use = ~data.truth.probing & data.truth_ran
        times, before, after = (
            of[use] for of in (data.truth.time_s, data.truth.uncompensated_um, data.truth.compensated_um)
        )
        return ToolCourse(times, before, after, "simulated", noise)
    if data.sphere_m is None:
        return None
    known = np.isfinite(data.measured).all(axis=1) & np.isfinite(data.predicted).all(axis=1)
    if not known.any():
        return None
    radius_m, height_m = data.sphere_m
    place = np.array([radius_m * 1e3, 0.0, height_m * 1e3, 0.0, 0.0])
    # The offsets are linear in the errors, and a place is all that the matrix depends on.
    matrix = np.column_stack([tcp_offsets(unit, place, radius_m) for unit in np.eye(9)])
    measured = data.measured[known]
    left = measured - data.predicted[known]
    return ToolCourse(data.time_s[known], measured @ matrix.T, left @ matrix.T, "measured", noise)
