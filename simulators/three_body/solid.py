"""Finite elements of the three-body machine: heat conduction and quasi-static thermoelasticity (scikit-fem).

Sizes and material: 1 x 0.8 x 1.4 m, steel of the comparison's material table. Quadratic hexahedra.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, FacetBasis, LinearForm, MeshHex, condense
from skfem.helpers import ddot, div, dot, eye, grad, sym_grad, trace

from simulators.plant import FloatArray
from simulators.three_body.model import DRIFTS, SOURCES, THERMOMETERS

CONDUCTIVITY = 60.5  # W/(m K)
HEAT_CAPACITY = 434.0 * 7850.0  # J/(m3 K)
FILM = 5.0  # W/(m2 K), every free surface; the contact with the floor counts as free
EXPANSION = 12e-6  # 1/K
_POISSON = 0.3  # the stiffness itself cancels: no outer forces act

# x0, x1, y0, y1, z0, z1 in m; y = 0 is the front
BODIES = {
    "base": (0.0, 1.0, 0.0, 0.8, 0.0, 0.3),
    "column": (0.2, 0.8, 0.55, 0.8, 0.3, 1.4),
    "spindle": (0.4, 0.6, 0.05, 0.55, 0.8, 1.2),
}
FOOT = 0.1  # m, side of the four square feet at the base's corners
TOOL, WORKPIECE = (0.5, 0.15, 0.8), (0.5, 0.15, 0.3)
# Near: within 0.1 m of a source. Far: at the back, where the heat comes late and mixed.
PLACES = ((0.5, 0.05, 0.3), (0.4, 0.15, 1.2), (0.1, 0.8, 0.3), (0.5, 0.8, 0.8))
_BREAKS = ((0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.8, 0.9, 1), (0, 0.05, 0.15, 0.55, 0.7, 0.8), (0, 0.3, 0.8, 1.2, 1.4))


@dataclass(frozen=True, slots=True)
class Solid:
    """C dT/dt = -(K + H) T + S q, outputs D T; T in K over ambient at n nodes."""

    C: csc_matrix
    K: csc_matrix
    H: csc_matrix
    S: FloatArray
    """(n, 2) shares of each source's watt; columns sum to 1."""
    D: FloatArray
    """(7, n) drifts in µm/K, then sensors."""
    nodes: FloatArray
    """(3, n) m."""


def mesh(size: float) -> MeshHex:
    """The three bodies in one grid of cells not longer than size (m), joined at their common faces."""
    lines = []
    for breaks in _BREAKS:
        parts = [np.linspace(a, b, int(np.ceil((b - a) / size - 1e-9)) + 1)[:-1] for a, b in pairwise(breaks)]
        lines.append(np.concatenate([*parts, [breaks[-1]]]))
    grid = MeshHex.init_tensor(*lines)
    x, y, z = grid.p[:, grid.t].mean(axis=1)
    inside = np.zeros(grid.t.shape[1], dtype=bool)
    for x0, x1, y0, y1, z0, z1 in BODIES.values():
        inside |= (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > z0) & (z < z1)
    return grid.restrict(np.flatnonzero(inside))


def assemble(size: float = 0.1, free: bool = False) -> Solid:
    """The whole model. Three adjoint elastic solves make rows of the drift, so stepping is thermal only.

    free: held at six displacements of three corners instead of the four feet, so that uniform warming causes no strain.
    """
    cells = mesh(size)
    heat = Basis(cells, ElementHex2(), intorder=4)
    skin = FacetBasis(cells, ElementHex2(), intorder=4)
    unit = BilinearForm(lambda u, v, _: u * v)
    stiff = BilinearForm(lambda u, v, _: dot(grad(u), grad(v)))
    mean = LinearForm(lambda v, _: v)
    on_front = cells.facets_satisfying(
        lambda x: (np.abs(x[1]) < 1e-9) & (x[0] > 0.2) & (x[0] < 0.8), boundaries_only=True
    )
    on_top = cells.facets_satisfying(lambda x: (np.abs(x[2] - 1.2) < 1e-9) & (x[1] < 0.55), boundaries_only=True)
    columns = []
    for facets in (on_front, on_top):
        load = mean.assemble(FacetBasis(cells, ElementHex2(), facets=facets, intorder=4))
        columns.append(load / load.sum())
    nodes = np.asarray(heat.doflocs, dtype=np.float64)
    rows = np.zeros((len(DRIFTS) + len(THERMOMETERS), nodes.shape[1]))
    rows[: len(DRIFTS)] = _drift_rows(cells, heat, free)
    for row, place in zip(rows[len(DRIFTS) :], PLACES, strict=True):
        row[_at(nodes, place)[0]] = 1.0
    if len(columns) != len(SOURCES):
        raise ValueError(f"sources: expected {SOURCES}, got {len(columns)} columns")
    return Solid(
        C=csc_matrix(HEAT_CAPACITY * unit.assemble(heat)),
        K=csc_matrix(CONDUCTIVITY * stiff.assemble(heat)),
        H=csc_matrix(FILM * unit.assemble(skin)),
        S=np.column_stack(columns),
        D=rows,
        nodes=nodes,
    )


def _drift_rows(cells: MeshHex, heat: Basis, free: bool) -> FloatArray:
    """(3, n) µm/K: d = c' E^-1 F T, so the rows are F' E^-1 c with E symmetric."""
    lame, shear = (
        _POISSON / ((1 + _POISSON) * (1 - 2 * _POISSON)),
        1 / (2 * (1 + _POISSON)),
    )  # per unit of Young's modulus
    motion = Basis(cells, ElementVector(ElementHex2()), intorder=4)

    def energy(u, v, _):  # type: ignore[no-untyped-def]
        strain = sym_grad(u)
        return ddot(lame * eye(trace(strain), 3) + 2 * shear * strain, sym_grad(v))

    swell = BilinearForm(lambda t, v, _: EXPANSION * (3 * lame + 2 * shear) * t * div(v)).assemble(heat, motion)
    places = np.asarray(motion.doflocs)
    x, y, z = places
    edge = FOOT + 1e-9
    feet = np.flatnonzero((z < 1e-9) & ((x < edge) | (x > 1 - edge)) & ((y < edge) | (y > 0.8 - edge)))
    if free:
        a, b, c = (_at(places, corner) for corner in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.8, 0.0)))
        feet = np.concatenate([a, b[1:], c[2:]])
    inner, kept = condense(BilinearForm(energy).assemble(motion), D=feet, expand=False), motion.complement_dofs(feet)
    solver = splu(csc_matrix(inner), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    rows = np.zeros((len(DRIFTS), heat.N))
    for axis in range(len(DRIFTS)):
        pick = np.zeros(motion.N)
        pick[_at(places, TOOL)[axis]] = 1.0
        pick[_at(places, WORKPIECE)[axis]] -= 1.0
        adjoint = np.zeros(motion.N)
        adjoint[kept] = solver.solve(pick[kept])
        rows[axis] = 1e6 * (swell.T @ adjoint)
    return rows


def _at(nodes: FloatArray, place: tuple[float, float, float]) -> NDArray[np.intp]:
    """Indices of the unknowns at a place; ValueError if the mesh has no node there."""
    found = np.flatnonzero(np.abs(nodes - np.array(place)[:, None]).max(axis=0) < 1e-9)
    if not found.size:
        raise ValueError(f"place: no node at {place} m; add its coordinates to the mesh's lines")
    return found
