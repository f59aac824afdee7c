"""Quasi-static elasticity of the bodies joined by springs: the nine errors caused by temperatures (scikit-fem)."""

from collections.abc import Mapping

import numpy as np
from scipy.sparse import block_array, block_diag, csc_matrix, diags_array, vstack
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex2, FacetBasis, LinearForm, MeshHex

from simulators.plant.body import FloatArray
from simulators.plant.shape import Box, Shape, inside
from talc.names import THERMAL_ERRORS

POISSON = 0.27
_LAME, _SHEAR = POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), 1 / (2 * (1 + POISSON))
"""Per unit of Young's modulus."""
_AXES = range(3)


def elastic_rows(shape: Shape, cells: Mapping[str, MeshHex]) -> dict[str, FloatArray]:
    """(10, n) by body: nine errors and the housing's stretch between bearing and nose, µm/K and µm/m/K.

    For an expansion of 1e-6/K. E u = F T and d = c' u give d = (F' E^-1 c)' T, E symmetric: one adjoint solve a row.
    """
    bases = {name: Basis(mesh, ElementHex2(), intorder=4) for name, mesh in cells.items()}
    spans, total = {}, 0
    for name, basis in bases.items():
        spans[name] = slice(total, total + 3 * basis.N)
        total += 3 * basis.N
    blocks = [shape.bodies[name].stiffness * stiffness(basis) for name, basis in bases.items()]
    joined = csc_matrix(block_diag(blocks) + _springs(shape, bases, spans, total))
    solver = splu(joined, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    adjoint = np.asarray(solver.solve(np.ascontiguousarray(observed(shape, bases, spans, total).T)))
    return {
        name: np.asarray((shape.bodies[name].stiffness * swelling(basis).T @ adjoint[spans[name]]).T, dtype=np.float64)
        for name, basis in bases.items()
    }


def stiffness(basis: Basis) -> csc_matrix:
    """(3N, 3N) isotropic, of unit Young's modulus; unknowns in the order x of all nodes, y of all, z of all."""
    d = [[BilinearForm(lambda u, v, _, a=a, b=b: v.grad[a] * u.grad[b]).assemble(basis) for b in _AXES] for a in _AXES]
    laplace = _SHEAR * (d[0][0] + d[1][1] + d[2][2])
    rows = [[_LAME * d[a][b] + _SHEAR * d[b][a] + (laplace if a == b else 0 * laplace) for b in _AXES] for a in _AXES]
    return csc_matrix(block_array(rows))


def swelling(basis: Basis) -> csc_matrix:
    """(3N, N) forces of nodal temperatures for unit expansion and unit Young's modulus."""
    bulk = 3 * _LAME + 2 * _SHEAR
    return csc_matrix(vstack([bulk * BilinearForm(lambda t, v, _, a=a: t * v.grad[a]).assemble(basis) for a in _AXES]))


def observed(shape: Shape, bases: Mapping[str, Basis], spans: Mapping[str, slice], total: int) -> FloatArray:
    """(10, total) the nine errors and the housing's stretch, of displacements. Workpiece side minus tool side."""
    motions, centres = {}, {}
    for name, frame in shape.frames.items():
        motions[name] = np.zeros((6, total))
        motions[name][:, spans[frame.body]], centres[name] = rigid_motion(bases[frame.body], frame.boxes)

    def at(name: str, height_m: float) -> FloatArray:
        """(3, total): displacement of the point (0, 0, height) that moves with a frame."""
        x, y, z = np.array([0.0, 0.0, height_m]) - centres[name]
        turn_x, turn_y, turn_z = motions[name][3:]
        arm = np.array([z * turn_y - y * turn_z, x * turn_z - z * turn_x, y * turn_x - x * turn_y])
        return np.asarray(motions[name][:3] + arm, dtype=np.float64)

    a_axis, c_axis, tool = at("a_axis", 0.0), at("c_axis", 0.0), at("seat", shape.tip_z_m)
    turn = {name: rows[3:] for name, rows in motions.items()}
    radius, top = shape.sphere_radius_m, max(box[5] for box in shape.bodies["table"].boxes)
    spheres = np.zeros((4, 3, total))
    for k, (x, y) in enumerate(((radius, 0.0), (-radius, 0.0), (0.0, radius), (0.0, -radius))):
        weights = bases["table"].probes(np.array([[x], [y], [top]])).toarray()
        spheres[k][:, spans["table"]] = np.kron(np.eye(3), weights)
    rows = {
        "EY0A": a_axis[1] - tool[1],
        "EZ0A": a_axis[2] - tool[2],
        "EX0C": c_axis[0] - tool[0],
        "EY0C": c_axis[1] - a_axis[1],
        "EZ0T": spheres[:, 2].mean(axis=0) - a_axis[2],
        "ER0T": (spheres[0, 0] - spheres[1, 0] + spheres[2, 1] - spheres[3, 1]) / 4,
        "EA0C": turn["c_axis"][0] - turn["y_guide"][0],
        "EB0C": turn["c_axis"][1] - turn["x_guide"][1],
        "EC0C": turn["c_axis"][2] - turn["x_guide"][2],
    }
    stretch = motions["nose"][2] - motions["seat"][2]
    return np.array([*(rows[name] for name in THERMAL_ERRORS), stretch])


def rigid_motion(basis: Basis, boxes: tuple[Box, ...]) -> tuple[FloatArray, FloatArray]:
    """(6, 3N) least-squares translation of the centre and rotation of the nodes in the boxes; (3,) the centre, m."""
    places = np.asarray(basis.doflocs, dtype=np.float64)
    chosen = np.flatnonzero(inside(places, boxes))
    if chosen.size < 3:
        raise ValueError(f"frame: fewer than three nodes lie in {boxes}")
    centre = places[:, chosen].mean(axis=1)
    x, y, z = places[:, chosen] - centre[:, None]
    one, none = np.ones_like(x), np.zeros_like(x)
    moved = np.block(
        [
            [np.array([one, none, none, none, z, -y]).T],
            [np.array([none, one, none, -z, none, x]).T],
            [np.array([none, none, one, y, -x, none]).T],
        ]
    )
    rows = np.zeros((6, 3 * basis.N))
    rows[:, np.concatenate([chosen + axis * basis.N for axis in _AXES])] = np.linalg.pinv(moved)
    return rows, np.asarray(centre, dtype=np.float64)


def _springs(shape: Shape, bases: Mapping[str, Basis], spans: Mapping[str, slice], total: int) -> csc_matrix:
    """(total, total) sum of k (mean_a - mean_b)(mean_a - mean_b)'."""
    rows, strengths = [], []
    for joint in shape.joints:
        for box in joint.boxes:
            for axis in _AXES:
                if joint.stiffness[axis] > 0:
                    row = np.zeros((1, total))
                    for sign, name in ((1.0, joint.first), (-1.0, joint.second)):
                        if name != "ground":
                            first, n = spans[name].start + axis * bases[name].N, bases[name].N
                            row[0, first : first + n] += sign * _mean(bases[name], box, name)
                    rows.append(csc_matrix(row))
                    strengths.append(joint.stiffness[axis])
    stacked = vstack(rows).tocsc()
    return csc_matrix(stacked.T @ diags_array(np.array(strengths, dtype=np.float64)) @ stacked)


def _mean(basis: Basis, box: Box, name: str) -> FloatArray:
    """(N,) area weights of the nodes on the body's faces in a box; they sum to 1."""
    mesh = basis.mesh
    skin = mesh.boundary_facets()
    on = skin[inside(mesh.p[:, mesh.facets[:, skin]].mean(axis=1), (box,))]
    if not on.size:
        raise ValueError(f"joint: no face of {name} lies in {box}")
    weights = LinearForm(lambda v, _: v).assemble(FacetBasis(mesh, ElementHex2(), facets=on, intorder=4))
    return np.asarray(weights / weights.sum(), dtype=np.float64)
