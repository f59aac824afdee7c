"""A machine with a table, a sphere on its stem and a touch probe: what the probe meets, and must keep away from.

Lengths in mm from where A and C meet; the positions are those of the axes, the probe's ball is its length below them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PROBE_MM, BALL_MM, SPHERE_MM = 150.0, 3.0, 10.0
CONTACT_MM = BALL_MM + SPHERE_MM
STEM_MM, TABLE_MM, TABLE_THICK_MM = 4.0, 200.0, 100.0
"""Radii of the stem and the table, whose top is at height 0."""
_BODY = ((25.0, 2.0), (50.0, 2.0), (60.0, 20.0), (90.0, 20.0), (120.0, 20.0), (150.0, 20.0))
"""Height above the ball's centre, and radius: of the stylus and of the probe that holds it."""


def on_table(positions: Floats, above_ball_mm: float = 0.0) -> Floats:
    """(n, 3) a point of the probe as the table sees it. positions: (n, 5)."""
    x, y, z = positions[:, 0], positions[:, 1], positions[:, 2] - PROBE_MM + above_ball_mm
    a, c = np.deg2rad(positions[:, 3]), np.deg2rad(positions[:, 4])
    y, z = np.cos(a) * y + np.sin(a) * z, np.cos(a) * z - np.sin(a) * y
    return np.stack([np.cos(c) * x + np.sin(c) * y, np.cos(c) * y - np.sin(c) * x, z], axis=1)


@dataclass
class Workshop:
    """sphere_mm: its centre at A = C = 0; present: whether it is there."""

    sphere_mm: tuple[float, float, float]
    present: bool = True
    post_mm: tuple[float, float, float] | None = None
    """Something else on the table: a post there, this high."""

    def gap(self, positions: Floats) -> Floats:
        """(n,) from the ball to the nearest thing; 0 or less: contact."""
        return self._gap(on_table(positions), BALL_MM)

    def body_gap(self, positions: Floats) -> Floats:
        """(n,) the same for stylus and probe."""
        gaps = [self._gap(on_table(positions, height), radius) for height, radius in _BODY]
        nearest: Floats = np.min(gaps, axis=0)
        return nearest

    def _gap(self, point: Floats, radius: float) -> Floats:
        x, y, z = point.T
        flat, below = np.hypot(x, y) - TABLE_MM, np.maximum(z, -TABLE_THICK_MM - z)
        table = np.where(np.minimum(flat, below) > 0, np.hypot(flat, below), np.maximum(flat, below))
        if self.post_mm is not None:
            beside, over = np.hypot(x - self.post_mm[0], y - self.post_mm[1]) - STEM_MM, z - self.post_mm[2]
            table = np.minimum(table, np.where(over > 0, np.hypot(np.maximum(beside, 0.0), over), beside))
        table = np.asarray(table - radius)
        if not self.present:
            return table
        along = np.clip(z, 0.0, self.sphere_mm[2])
        foot = np.stack([np.full_like(x, self.sphere_mm[0]), np.full_like(x, self.sphere_mm[1]), along], axis=1)
        stem = np.linalg.norm(point - foot, axis=1) - STEM_MM
        sphere = np.linalg.norm(point - np.array(self.sphere_mm), axis=1) - SPHERE_MM
        nearest: Floats = np.minimum(np.minimum(sphere, stem) - radius, table)
        return nearest

    def taught(self, a_deg: float, c_deg: float) -> Floats:
        """(3,) positions of X, Y, Z with the ball in the sphere's centre: Rx(a) Rz(c) and the probe's length."""
        a, c = np.deg2rad(a_deg), np.deg2rad(c_deg)
        x, y, z = self.sphere_mm
        x, y = np.cos(c) * x - np.sin(c) * y, np.sin(c) * x + np.cos(c) * y
        return np.array([x, np.cos(a) * y - np.sin(a) * z, np.sin(a) * y + np.cos(a) * z + PROBE_MM])
