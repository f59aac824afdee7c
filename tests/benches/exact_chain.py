"""Where tool and workpiece are on a machine with errors: the exact product of 4 x 4 transforms, joint by joint.

Written from the standards' definitions, and not from talc.chain: no angle is taken for small.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
PROBE_M, RADIUS_M = 0.15, 0.2


def exact_deviation(
    chain: str, origins: Mapping[str, Floats], errors: Mapping[str, float], point: Floats, angles: Mapping[str, float]
) -> Floats:
    """(3,) µm, workpiece minus tool, where the tip of a machine without errors touches the point; metres, radians.

    errors: µm and µm/m; those that are not named are 0.
    """
    words = chain.split()
    bed = words.index("b")
    workpiece, tool = [word[0] for word in reversed(words[1:bed])], words[bed + 1 : -2]
    small = {name: size * 1e-6 for name, size in errors.items()}
    touched, tip = np.append(point, 1.0), np.array([0.0, 0.0, 0.0, 1.0])
    straight = dict.fromkeys("XYZ", 0.0)
    at = _product(workpiece, origins, {}, straight, angles, -1.0) @ touched
    reached = at - _product(tool, origins, {}, straight, angles, 1.0) @ tip
    moved = dict(zip("XYZ", reached[:3].tolist(), strict=True))
    table = next((axis for axis in reversed(workpiece) if axis in "ABC"), "")
    normal = np.eye(3)["ABC".index(table or "C")]
    centre = origins.get(table, np.zeros(3))
    out = point - centre
    across = out - normal * (normal @ out)
    grown = point + across * small.get("ER0T", 0.0) / RADIUS_M + normal * small.get("EZ0T", 0.0)
    spindle = _at(np.array([0.0, 0.0, PROBE_M]), _tilt(small, "S")) @ _shift(
        *(small.get(f"E{k}0S", 0.0) for k in "XYZ")
    )
    real = _product(workpiece, origins, small, moved, angles, -1.0) @ np.append(grown, 1.0)
    real_tip = _product(tool, origins, small, moved, angles, 1.0) @ spindle @ tip
    return np.asarray((real - real_tip)[:3] * 1e6)


def _product(
    axes: list[str], origins: Mapping[str, Floats], small: Mapping[str, float], moved: Mapping[str, float],
    angles: Mapping[str, float], side: float,
) -> Floats:  # fmt: skip
    matrix = np.eye(4)
    for axis in axes:
        if axis in "XYZ":
            k = "XYZ".index(axis)
            turned = {"Y": ("C", "EC0Y"), "Z": ("BA", "EB0Z EA0Z")}.get(axis, ("", ""))
            way = np.append(np.eye(3)[k] * moved[axis] * (1.0 + small.get(f"E{axis}{axis}", 0.0)), 0.0)
            for about, name in zip(turned[0], turned[1].split(), strict=True):
                way = _turn(about, small.get(name, 0.0)) @ way
            matrix = matrix @ _shift(*(side * way[:3]))
        else:
            place = _shift(*(small.get(f"E{k}0{axis}", 0.0) for k in "XYZ")) @ _tilt(small, axis)
            matrix = matrix @ _at(origins.get(axis, np.zeros(3)), place @ _turn(axis, angles[axis]))
    return matrix


def _tilt(small: Mapping[str, float], axis: str) -> Floats:
    a, b, c = (_turn(about, small.get(f"E{about}0{axis}", 0.0)) for about in "ABC")
    return c @ b @ a


def _at(origin: Floats, motion: Floats) -> Floats:
    return _shift(*origin) @ motion @ _shift(*-origin)


def _shift(x: float, y: float, z: float) -> Floats:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def _turn(about: str, angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    turns = {
        "A": [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]],
        "B": [[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]],
        "C": [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    }
    return np.array(turns[about], dtype=np.float64)
