"""The kinematic chain V[w - C' - A' - X' - b - Y - Z - S - t] and the offsets that cancel the thermal errors.

Machine coordinates: origin where the A and C axes meet at A = C = 0. The tool tip touches the workpiece at the machine
position (X, Y, Z), which in the frame of the turned table is the point Rx(a)^-1 (X, Y, Z). Table-side errors move that
point by delta; moving the tool by delta as well keeps it where it was on the workpiece.
"""

import math

import numpy as np

from talc.frame import FloatArray
from talc.probing import deviation_matrix, rotation_x

_MM = 1e-3
_RADIAL_REFERENCE_MIN_M = 1e-6


def tcp_offsets(errors: FloatArray, positions: FloatArray, sphere_radius_m: float | None = None) -> FloatArray:
    """(3,) shift of the tool in X, Y, Z, µm, that follows the workpiece point at the tool tip.

    errors: (9,) thermal errors, µm and µm/m; positions: (5,) X Y Z in mm from where A and C meet, A C in rad.
    sphere_radius_m: radius at which ER0T was measured; radial growth is proportional to the radius. None: ER0T counts
    in full wherever the tool is.
    Raises ValueError for a wrong shape or a value that is not finite.
    """
    errors, positions = np.asarray(errors, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    if errors.shape != (9,) or positions.shape != (5,):
        raise ValueError(f"errors {errors.shape}, positions {positions.shape}: expected (9,) and (5,)")
    if not (np.isfinite(errors).all() and np.isfinite(positions).all()):
        raise ValueError("errors or positions hold a value that is not finite")
    a = float(positions[3])
    point = rotation_x(-a) @ positions[:3] * _MM
    return np.asarray(deviation_matrix(a, point, _radial(point, sphere_radius_m)) @ errors, dtype=np.float64)


def _radial(point: FloatArray, sphere_radius_m: float | None) -> FloatArray:
    """Direction of radial growth at a point of the table, times the share of ER0T it sees."""
    radius = math.hypot(point[0], point[1])
    if radius < _RADIAL_REFERENCE_MIN_M:
        return np.zeros(3)
    share = 1.0 if sphere_radius_m is None else radius / sphere_radius_m
    return np.array([point[0], point[1], 0.0]) / radius * share
