"""Finite elements of the machine's bodies: heat conduction, each body by itself (scikit-fem)."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.sparse import block_diag, csc_matrix
from skfem import Basis, BilinearForm, ElementHex2, FacetBasis, LinearForm, MeshHex
from skfem.helpers import dot, grad

from simulators.plant.body import BodyModel, Face, FloatArray
from simulators.plant.elastic import elastic_rows
from simulators.plant.shape import Shape, inside

_EPS = 1e-6


def mesh_body(shape: Shape, body: str, coarser: float = 1.0) -> MeshHex:
    """A body's cells, not longer than its `mesh_m` times `coarser`; every box's edge is a line of the grid."""
    boxes = np.array(shape.boxes_of(body))
    size = shape.bodies[body].mesh_m * coarser
    lines = []
    for k in (0, 2, 4):
        at = np.unique(np.round(boxes[:, k : k + 2], 6))
        parts = [np.linspace(a, b, int(np.ceil((b - a) / size - _EPS)) + 1)[:-1] for a, b in pairwise(at)]
        lines.append(np.concatenate([*parts, at[-1:]]))
    grid = MeshHex.init_tensor(*lines)
    return grid.restrict(np.flatnonzero(inside(grid.p[:, grid.t].mean(axis=1), shape.bodies[body].boxes)))


def assemble_bodies(shape: Shape, coarser: float = 1.0) -> dict[str, BodyModel]:
    """The whole model, by body."""
    cells = {name: mesh_body(shape, name, coarser) for name in shape.bodies}
    rows = elastic_rows(shape, cells)
    return {name: replace(conduction(shape, name, cells[name]), elastic=rows[name]) for name in shape.bodies}


def conduction(shape: Shape, name: str, cells: MeshHex) -> BodyModel:
    """One body alone, without elastic rows. ValueError if a patch has no face there."""
    body = shape.bodies[name]
    heat = Basis(cells, ElementHex2(), intorder=4)
    unit = BilinearForm(lambda u, v, _: u * v)
    mean = LinearForm(lambda v, _: v)
    stiff = BilinearForm(lambda u, v, _: dot(grad(u), grad(v)))
    skin = cells.boundary_facets()
    middles = cells.p[:, cells.facets[:, skin]].mean(axis=1)
    faces = {}
    for patch, boxes in shape.patches.items():
        if patch.startswith(f"{name}."):
            on = skin[inside(middles, boxes)]
            if not on.size:
                raise ValueError(f"patch {patch}: no face of {name} lies in {boxes}")
            basis = FacetBasis(cells, ElementHex2(), facets=on, intorder=4)
            g = mean.assemble(basis)
            faces[patch] = Face(csc_matrix(unit.assemble(basis)), g, float(g.sum()))
    points = {
        point: np.asarray(heat.probes(np.array(place)[:, None]).toarray()[0])
        for point, place in shape.points.items()
        if point.startswith(f"{name}.")
    }
    return BodyModel(
        C=csc_matrix(body.heat_capacity * unit.assemble(heat)),
        K=csc_matrix(body.conductivity * stiff.assemble(heat)),
        faces=faces,
        points=points,
        even=np.ones(heat.N),
        elastic=np.zeros((0, heat.N)),
    )


class SparseSum:
    """A sparse matrix that is accumulated, for `join` over whole bodies."""

    def __init__(self, n: int) -> None:
        self._n, self._total = n, csc_matrix((n, n))

    def block(self, at: int, matrix: csc_matrix, weight: float) -> None:
        """Add weight * matrix from row and column `at` on."""
        after = self._n - at - matrix.shape[0]
        padded = block_diag([csc_matrix((at, at)), matrix, csc_matrix((after, after))])
        self._total = csc_matrix(self._total + weight * padded)

    def outer(self, left: FloatArray, right: FloatArray, weight: float) -> None:
        """Add weight * left right'."""
        self._total = csc_matrix(self._total + weight * (csc_matrix(left).T @ csc_matrix(right)))

    def matrix(self) -> csc_matrix:
        """The sum."""
        return self._total
