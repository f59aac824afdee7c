"""Position of the sphere on the table for given thermal errors. Standard library only: LinuxCNC's Python runs it."""

import math
from collections.abc import Sequence

Xyz = tuple[float, float, float]


def centre_mm(errors: Sequence[float], a_deg: float, c_deg: float, radius_mm: float, height_mm: float) -> Xyz:
    """Centre of the sphere from where A and C meet, machine axes.

    errors: nine in the order of THERMAL_ERRORS, µm and µm/m, ER0T at the sphere's radius; chain
    T_A Rx(a) T_C (small angles) applied to the sphere on the table after C's turn, grown by ER0T and EZ0T.
    """
    ey0a, ez0a, ex0c, ey0c, ez0t, er0t = (e * 1e-3 for e in errors[:6])
    ea0c, eb0c, ec0c = (e * 1e-6 for e in errors[6:])
    a, c = math.radians(a_deg), math.radians(c_deg)
    r, z = radius_mm + er0t, height_mm + ez0t
    x, y = r * math.cos(c), r * math.sin(c)
    tilted = (x - ec0c * y + eb0c * z + ex0c, ec0c * x + y - ea0c * z + ey0c, -eb0c * x + ea0c * y + z)
    return (
        tilted[0],
        tilted[1] * math.cos(a) - tilted[2] * math.sin(a) + ey0a,
        tilted[1] * math.sin(a) + tilted[2] * math.cos(a) + ez0a,
    )
