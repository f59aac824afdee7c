"""One body's heat conduction as matrices: full (finite elements) or reduced by a congruence, in the same form."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Matrix = Any
"""A NumPy array if reduced; otherwise a sparse SciPy matrix, which is not needed at run time."""


@dataclass(frozen=True, slots=True)
class Face:
    """A patch of the surface: a film of h W/(m2 K) adds h * H to the body's matrix, and h * g * T to its heat input."""

    H: Matrix
    """(n, n) m2, symmetric, positive semidefinite"""
    g: FloatArray
    """(n,) m2; g @ T / area is the patch's mean temperature"""
    area: float


@dataclass(frozen=True, slots=True)
class BodyModel:
    """C dT/dt = -(K + sum h H) T + sum h g T_outside, n coordinates."""

    C: Matrix
    """(n, n) J/K, symmetric, positive definite"""
    K: Matrix
    """(n, n) W/K, symmetric, positive semidefinite: K @ even = 0"""
    faces: Mapping[str, Face]
    points: Mapping[str, FloatArray]
    """(n,) rows that give the temperature of a point"""
    even: FloatArray
    """(n,) coordinates of 1 K everywhere"""
    elastic: FloatArray
    """(10, n) µm/K and µm/m/K for 1e-6/K of expansion: nine errors, then the housing's share of the spindle growth"""

    def project(self, basis: FloatArray) -> "BodyModel":
        """Galerkin: every matrix X becomes V' X V, so symmetry, definiteness and stability stay for any films h >= 0.

        basis (n, r) must contain uniform warming; otherwise a body at uniform temperature would conduct heat within
        itself. ValueError if it does not.
        """
        weighted = basis.T @ (self.C @ basis)
        even = np.linalg.solve(weighted, basis.T @ (self.C @ self.even))
        if np.abs(basis @ even - self.even).max() > 1e-6:
            raise ValueError("basis: expected to hold an even warming")

        def both(matrix: Matrix) -> FloatArray:
            small = basis.T @ (matrix @ basis)
            return np.asarray((small + small.T) / 2, dtype=np.float64)

        return BodyModel(
            C=both(self.C),
            K=both(self.K),
            faces={name: Face(both(face.H), basis.T @ face.g, face.area) for name, face in self.faces.items()},
            points={name: row @ basis for name, row in self.points.items()},
            even=even,
            elastic=self.elastic @ basis,
        )
