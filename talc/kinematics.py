"""The kinematic chain V[w - C' - A' - X' - b - Y - Z - S - t] and the offsets that cancel the thermal errors.

Machine coordinates: origin where the A and C axes meet at A = C = 0. The tool tip touches the workpiece at the machine
position (X, Y, Z), which in the frame of the turned table is the point Rx(a)^-1 (X, Y, Z). Table-side errors move that
point by delta; moving the tool by delta as well keeps it where it was on the workpiece.
"""

import numpy as np

from talc.frame import FloatArray
from talc.probing import deviation_matrix, rotation_x

_MM = 1e-3


def tcp_offsets(errors: FloatArray, positions: FloatArray, sphere_radius_m: float) -> FloatArray:
    """(3,) shift of the tool in X, Y, Z, µm, that follows the workpiece point at the tool tip.

    errors: (9,) thermal errors, µm and µm/m; positions: (5,) X Y Z in mm from where A and C meet, A C in rad.
    sphere_radius_m: radius at which ER0T was measured; a table grows in proportion to the radius.
    Raises ValueError for a wrong shape or a value that is not finite.
    """
    errors, positions = np.asarray(errors, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    if errors.shape != (9,) or positions.shape != (5,):
        raise ValueError(f"errors {errors.shape}, positions {positions.shape}: expected (9,) and (5,)")
    if not (np.isfinite(errors).all() and np.isfinite(positions).all()):
        raise ValueError("errors or positions hold a value that is not finite")
    if not sphere_radius_m > 0:
        raise ValueError(f"sphere_radius_m = {sphere_radius_m!r}: expected more than 0")
    a = float(positions[3])
    point = rotation_x(-a) @ positions[:3] * _MM
    growth = np.array([point[0], point[1], 0.0]) / sphere_radius_m
    return np.asarray(deviation_matrix(a, point, growth) @ errors, dtype=np.float64)
