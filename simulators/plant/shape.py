"""The machine's shape (`shape.toml`): boxes, faces, joints, and the frames that the nine errors compare."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SHAPE = Path(__file__).with_name("shape.toml")
Box = tuple[float, float, float, float, float, float]
"""x0, x1, y0, y1, z0, z1 in m; equal ends make a face."""


@dataclass(frozen=True, slots=True)
class Body:
    """Boxes of one homogenised material: every number accounts for the casting's share of iron."""

    boxes: tuple[Box, ...]
    heat_capacity: float
    """J/(m3 K)"""
    conductivity: float
    """W/(m K)"""
    stiffness: float
    """Young's modulus, MPa: with metres it gives N/µm."""
    mesh_m: float


@dataclass(frozen=True, slots=True)
class Joint:
    """Springs between mean displacements; `second` may be "ground"."""

    first: str
    second: str
    boxes: tuple[Box, ...]
    stiffness: tuple[float, float, float]
    """N/µm along X, Y, Z"""


@dataclass(frozen=True, slots=True)
class RigidNodes:
    """Nodes of one body to which a rigid motion is fitted."""

    body: str
    boxes: tuple[Box, ...]


@dataclass(frozen=True, slots=True)
class Shape:
    """Everything geometric. Patch and point names are `body.name`."""

    bodies: Mapping[str, Body]
    patches: Mapping[str, tuple[Box, ...]]
    points: Mapping[str, tuple[float, float, float]]
    joints: tuple[Joint, ...]
    frames: Mapping[str, RigidNodes]
    tip_z_m: float
    sphere_radius_m: float

    def boxes_of(self, body: str) -> list[Box]:
        """All boxes whose edges must be lines of that body's mesh."""
        found = list(self.bodies[body].boxes)
        found += [box for name, boxes in self.patches.items() if name.startswith(f"{body}.") for box in boxes]
        found += [box for joint in self.joints if body in (joint.first, joint.second) for box in joint.boxes]
        found += [box for frame in self.frames.values() if frame.body == body for box in frame.boxes]
        return found


def inside(places: NDArray[np.float64], boxes: tuple[Box, ...]) -> NDArray[np.bool_]:
    """(k,) which of the places (3, k), m, are in any of the boxes, to within a micrometre."""
    found = np.zeros(places.shape[1], dtype=np.bool_)
    for x0, x1, y0, y1, z0, z1 in boxes:
        low, high = np.array([[x0], [y0], [z0]]) - 1e-6, np.array([[x1], [y1], [z1]]) + 1e-6
        found |= ((places >= low) & (places <= high)).all(axis=0)
    return found


def merge(table: dict[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """`table` with the changes of a variant: tables are merged, anything else is replaced."""
    merged = dict(table)
    for key, value in change.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, dict) and isinstance(value, Mapping) else value
    return merged


def read_shape(change: Mapping[str, Any] | None = None) -> Shape:
    """The shape of `shape.toml`, with a variant's changes. ValueError names an invalid entry."""
    table = merge(tomllib.loads(_SHAPE.read_text(encoding="utf-8")), change or {})
    bodies = {}
    for name, row in table["body"].items():
        material, fill = table["material"][row["of"]], row["fill"]
        bodies[name] = Body(
            boxes=_boxes(row["boxes"], f"body.{name}"),
            heat_capacity=material["rho"] * material["c"] * fill,
            conductivity=material["k"] * fill,
            stiffness=material["E"] * 1e3 * fill,
            mesh_m=row["mesh_m"],
        )
    for kind in ("patch", "point"):
        for name in table[kind]:
            if name.split(".")[0] not in bodies:
                raise ValueError(f"{kind} {name!r}: expected 'body.name', body one of {', '.join(bodies)}")
    joints = []
    for row in table["joint"]:
        first, second = row["of"]
        if first not in bodies or second not in (*bodies, "ground"):
            raise ValueError(f"joint of {row['of']}: one of {', '.join(bodies)}, ground as the second")
        x, y, z = (table["joint_times"] * k for k in row["k"])
        joints.append(Joint(first, second, _boxes(row["boxes"], f"joint of {row['of']}"), (x, y, z)))
    return Shape(
        bodies=bodies,
        patches={name: _boxes(boxes, f"patch.{name}") for name, boxes in table["patch"].items()},
        points={name: (row[0], row[1], row[2]) for name, row in table["point"].items()},
        joints=tuple(joints),
        frames={
            name: RigidNodes(row["of"], _boxes(row["boxes"], f"frame.{name}")) for name, row in table["frame"].items()
        },
        tip_z_m=table["tool"]["tip_z_m"],
        sphere_radius_m=table["tool"]["sphere_radius_m"],
    )


def _boxes(rows: list[list[float]], where: str) -> tuple[Box, ...]:
    for row in rows:
        if len(row) != 6 or any(row[k] > row[k + 1] for k in (0, 2, 4)):
            raise ValueError(f"{where}: box {row}, expected [x0, x1, y0, y1, z0, z1] in rising order")
    return tuple((b[0], b[1], b[2], b[3], b[4], b[5]) for b in rows)
