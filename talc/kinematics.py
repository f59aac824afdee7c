"""The kinematic chain V[w - C' - A' - X' - b - Y - Z - S - t] and the offsets that cancel the thermal errors.

Machine coordinates: origin where the A and C axes meet at A = C = 0. The tool tip touches the workpiece at the machine
position (X, Y, Z), which in the frame of the turned table is the point Rx(a)^-1 (X, Y, Z). Table-side errors move that
point by delta; moving the tool by delta as well keeps it where it was on the workpiece.

Examples
--------
The A axis has sunk by 30 µm, and the table has grown by 10 µm at 150 mm; the tool stands 200 mm out on X:

>>> import numpy as np
>>> from talc import kinematics
>>> errors = np.array([0, -30, 0, 0, 0, 10, 0, 0, 0])
>>> offsets = kinematics.tcp_offsets(errors, np.array([200, 0, 50, 0, 0]), sphere_radius_m=0.15)
>>> [round(float(um), 1) for um in offsets]
[13.3, 0.0, -30.0]
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from talc.frame import FloatArray
from talc.probing import FARTHEST_M, MOST_RAD, deviation_matrix, refuse_millimetres, rotation_x

CHAIN: Final = "w-C'-A'-X'-b-Y-Z-S-t"
"""From the workpiece w over the bed b to the tool t; ' marks the axes that move the workpiece."""
_MM = 1e-3


def tcp_offsets(errors: FloatArray, positions: FloatArray, sphere_radius_m: float) -> FloatArray:
    """(3,) shift of the tool in X, Y, Z, µm, that follows the workpiece point at the tool tip.

    errors: (9,) thermal errors, µm and µm/m; positions: (5,) X Y Z in mm from where A and C meet, A C in rad.
    sphere_radius_m: radius at which ER0T was measured; a table grows in proportion to the radius.
    Raises ValueError for a wrong shape, a value that is not finite, or sizes that only degrees and millimetres have.
    """
    errors, positions = np.asarray(errors, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    if errors.shape != (9,) or positions.shape != (5,):
        raise ValueError(f"errors {errors.shape}, positions {positions.shape}: expected (9,) and (5,)")
    if not (np.isfinite(errors).all() and np.isfinite(positions).all()):
        raise ValueError("errors or positions hold a value that is not finite")
    if not sphere_radius_m > 0:
        raise ValueError(f"sphere_radius_m = {sphere_radius_m!r}: expected more than 0")
    refuse_millimetres("sphere_radius_m", sphere_radius_m, FARTHEST_M)
    if abs(positions[3]) > MOST_RAD:
        raise ValueError(f"A = {positions[3]:g} rad: expected radians; np.radians converts degrees")
    return np.asarray(offset_matrix(positions, sphere_radius_m) @ errors, dtype=np.float64)


def offset_matrix(positions: FloatArray, sphere_radius_m: float) -> FloatArray:
    """(3, 9) offset of X, Y, Z in µm per unit of each error at positions (5,); see `tcp_offsets`."""
    a = float(positions[3])
    point = rotation_x(-a) @ positions[:3] * _MM
    growth = np.array([point[0], point[1], 0.0]) / sphere_radius_m
    return deviation_matrix(a, point, growth)


def largest_offsets(reach_m: tuple[float, float], sphere_radius_m: float) -> FloatArray:
    """(3, 9) largest magnitude of each axis' offset per unit of each error, at any A and C and any point in reach.

    reach_m: farthest point from where A and C meet, along X and across it.
    """
    along, across = reach_m
    grown_x, grown = along / sphere_radius_m, across / sphere_radius_m
    return np.array(
        [
            [0.0, 0.0, 1.0, 0.0, 0.0, grown_x, 0.0, across, across],
            [1.0, 0.0, 0.0, 1.0, 1.0, grown, across, along, along],
            [0.0, 1.0, 0.0, 1.0, 1.0, grown, across, along, along],
        ]
    )


@dataclass(frozen=True, slots=True)
class AxisForm:
    """Offsets in the form that controls take: K0 + tan(beta) (P - P0), for one position of A."""

    k0: FloatArray
    """(3,) offset of X, Y, Z at the reference, µm."""
    slope: FloatArray
    """(3, 3) tan(beta), µm/mm: row: compensated axis, column: axis whose position counts."""
    reference: FloatArray
    """(3,) P0, mm."""

    def offsets(self, position: FloatArray) -> FloatArray:
        """(3,) µm at a position X, Y, Z in mm."""
        return np.asarray(self.k0 + self.slope @ (position - self.reference), dtype=np.float64)


def axis_form(errors: FloatArray, a: float, reference: FloatArray, sphere_radius_m: float) -> AxisForm:
    """The offsets' K0 and slopes at one A position (rad); reference: (3,) P0, mm.

    Exact: with A fixed the offsets are linear in the position, and C does not matter. ValueError as `tcp_offsets`.
    """
    reference = np.asarray(reference, dtype=np.float64)
    if reference.shape != (3,):
        raise ValueError(f"reference has shape {reference.shape}: expected (3,) X, Y, Z in mm")

    def at(position: FloatArray) -> FloatArray:
        return tcp_offsets(errors, np.array([*position, a, 0.0]), sphere_radius_m)

    k0 = at(reference)
    slope = np.column_stack([at(reference + step) - k0 for step in np.eye(3)])
    return AxisForm(k0, slope, reference)


def workpiece_growth(
    point_mm: FloatArray,
    fixed_mm: FloatArray,
    *,
    expansion_per_K: float,
    temperature_degC: float,
    reference_degC: float,
) -> FloatArray:
    """(3,) µm by which a workpiece point moves away from the point where the workpiece is held (B19's outlook).

    Added to the compensation, it keeps features at their size at the reference temperature (ISO 1: 20 degC).
    point_mm, fixed_mm: (3,) in workpiece coordinates; expansion_per_K: e.g. 23.1e-6 aluminium, 11.5e-6 steel.
    ValueError: a wrong shape, a value that is not finite, or an expansion outside 0 to 1e-4 per K.
    """
    point, fixed = np.asarray(point_mm, dtype=np.float64), np.asarray(fixed_mm, dtype=np.float64)
    if point.shape != (3,) or fixed.shape != (3,):
        raise ValueError(f"point_mm {point.shape}, fixed_mm {fixed.shape}: expected (3,) and (3,)")
    if not (np.isfinite(point).all() and np.isfinite(fixed).all() and np.isfinite(temperature_degC - reference_degC)):
        raise ValueError("point_mm, fixed_mm or a temperature holds a value that is not finite")
    if not 0.0 <= expansion_per_K <= 1e-4:
        raise ValueError(f"expansion_per_K = {expansion_per_K}: expected 0 to 1e-4 (steel: 11.5e-6)")
    return np.asarray(expansion_per_K * (temperature_degC - reference_degC) * (point - fixed) * 1e3, dtype=np.float64)
