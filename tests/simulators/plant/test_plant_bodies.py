"""Finite elements of the five-axis machine against closed forms and scikit-fem's elasticity; reduced against whole."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, ElementHex2, ElementVector
from skfem.models.elasticity import lame_parameters, linear_elasticity

from simulators.plant import FloatArray, machine_tables, reduced
from simulators.plant.body import BodyModel
from simulators.plant.elastic import POISSON, rigid_motion, stiffness, swelling
from simulators.plant.generate import basis as chosen_basis
from simulators.plant.joined import Joined, join
from simulators.plant.shape import Body, Shape, read_shape
from simulators.plant.solid import SparseSum, assemble_bodies, conduction, mesh_body
from talc.names import THERMAL_ERRORS

LENGTH, SIDE, K, RHO_C = 1.0, 0.1, 50.0, 3.6e6
BAR = Shape(
    bodies={"bar": Body(((0, LENGTH, 0, SIDE, 0, SIDE),), RHO_C, K, 1e5, 0.1)},
    patches={"bar.hot": ((0, 0, 0, SIDE, 0, SIDE),), "bar.cold": ((LENGTH, LENGTH, 0, SIDE, 0, SIDE),)},
    points={"bar.middle": (0.5, 0.03, 0.07)},
    joints=(),
    frames={},
    tip_z_m=0,
    sphere_radius_m=0,
)


@pytest.fixture(scope="module")
def bar() -> BodyModel:
    return conduction(BAR, "bar", mesh_body(BAR, "bar"))


def test_bar_heated_at_one_end_and_cooled_at_the_other(bar: BodyModel) -> None:
    hot, cold, area = bar.faces["bar.hot"], bar.faces["bar.cold"], SIDE**2
    film, watts = 20.0, 10.0
    t = splu(csc_matrix(bar.K + film * cold.H)).solve(watts * hot.g / hot.area)
    end = watts / (film * area)
    assert cold.g @ t / cold.area == pytest.approx(end, rel=1e-9)
    assert hot.g @ t / hot.area == pytest.approx(end + watts * LENGTH / (K * area), rel=1e-9)
    assert bar.points["bar.middle"] @ t == pytest.approx(end + watts * LENGTH / (K * area) / 2, rel=1e-9)
    assert bar.even @ (bar.C @ bar.even) == pytest.approx(RHO_C * LENGTH * area)


def test_bar_forgets_at_the_rate_of_the_heat_equation(bar: BodyModel) -> None:
    rates = eigh(bar.K.toarray(), bar.C.toarray(), eigvals_only=True, subset_by_index=[0, 3])
    expected = K / RHO_C * (np.pi * np.arange(4) / LENGTH) ** 2
    assert rates == pytest.approx(expected, rel=2e-3, abs=1e-12)


def test_projection_keeps_balance_and_needs_an_even_warming(bar: BodyModel) -> None:
    hot = splu(csc_matrix(bar.K + 1e-4 * bar.C)).solve(bar.faces["bar.hot"].g)
    small = bar.project(chosen_basis(bar, 1e4 * hot[:, None], hot[:, None] / abs(hot).max()))
    assert small.C.shape[0] <= 3
    assert small.K @ small.even == pytest.approx(0, abs=1e-9)
    assert small.even @ (small.C @ small.even) == pytest.approx(bar.even @ (bar.C @ bar.even))
    assert small.faces["bar.cold"].g @ small.even == pytest.approx(SIDE**2)
    with pytest.raises(ValueError, match="even warming"):
        bar.project(hot[:, None])


def test_free_body_bends_as_a_linear_temperature_demands() -> None:
    """T = g z gives u = g (x z, y z, (z² - x² - y²)/2) without stress; T = 1 gives u = (x, y, z)."""
    basis = Basis(mesh_body(BAR, "bar"), ElementHex2(), intorder=4)
    x, y, z = np.asarray(basis.doflocs)
    matrix, force = stiffness(basis), swelling(basis)
    bent = np.concatenate([x * z, y * z, (z**2 - x**2 - y**2) / 2])
    size = abs(matrix).max()
    assert matrix @ bent == pytest.approx(force @ z, abs=1e-9 * size)
    assert matrix @ np.concatenate([x, y, z]) == pytest.approx(force @ np.ones_like(x), abs=1e-9 * size)
    assert matrix @ np.concatenate([-y, x, 0 * z]) == pytest.approx(0, abs=1e-9 * size)


def test_stiffness_is_that_of_scikit_fem() -> None:
    cells = mesh_body(BAR, "bar")
    basis, theirs = Basis(cells, ElementHex2(), intorder=4), Basis(cells, ElementVector(ElementHex2()), intorder=4)
    matrix = linear_elasticity(*lame_parameters(1.0, POISSON)).assemble(theirs)

    def field(place: FloatArray) -> FloatArray:
        x, y, z = place
        return np.array([x * y - z**2, 2 * x * z + y, x**2 - 3 * y * z])

    ours = np.concatenate(list(field(np.asarray(basis.doflocs))))
    projected = theirs.project(field)
    assert ours @ stiffness(basis) @ ours == pytest.approx(projected @ matrix @ projected, rel=1e-9)


def test_rigid_motion_is_found_again() -> None:
    basis = Basis(mesh_body(BAR, "bar"), ElementHex2(), intorder=4)
    rows, centre = rigid_motion(basis, ((0, 0.3, 0, SIDE, 0, SIDE),))
    assert centre == pytest.approx([0.15, 0.05, 0.05])
    shift, turn = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.2, -0.5])
    moved = shift[:, None] + np.cross(turn, np.asarray(basis.doflocs).T - centre).T
    assert rows @ moved.ravel() == pytest.approx([*shift, *turn])


def test_committed_bodies_weigh_what_the_table_says() -> None:
    shape = read_shape()
    for name, model in reduced("base").items():
        body = shape.bodies[name]
        volume = sum((b[1] - b[0]) * (b[3] - b[2]) * (b[5] - b[4]) for b in body.boxes)
        assert model.even @ (model.C @ model.even) == pytest.approx(body.heat_capacity * volume, rel=1e-9)
        assert model.K @ model.even == pytest.approx(0, abs=1e-9 * abs(model.K).max() * abs(model.even).max())
        for patch, face in model.faces.items():
            assert face.area == pytest.approx(
                sum(
                    np.prod([w for w in (b[1] - b[0], b[3] - b[2], b[5] - b[4]) if w > 0]) for b in shape.patches[patch]
                )
            )
            assert model.even @ (face.H @ model.even) == pytest.approx(face.area)


def follow(joined: Joined, name: str = "base") -> FloatArray:
    """(60, k) errors, points and nodes over 5 h of random loads, hall, films; implicit Euler, 5 min."""
    draw, table = np.random.default_rng(3), machine_tables(name).machine
    watts = [row.get("linear", 0) + row["power"] for row in table["heat"].values()]
    seen = np.vstack([joined.elastic, joined.growth, *joined.points.values()])
    x, out = np.zeros(joined.even.size), []
    for block in range(5):
        heat = joined.heat_to @ (watts * draw.random(len(watts)) * (draw.random(len(watts)) < 0.4))
        heat = heat + joined.outside @ draw.normal(0, 3, joined.outside.shape[1])
        rate = joined.K
        for factor, film in zip((1, block % 2, *draw.random(2)), joined.films, strict=True):
            rate = rate + factor * film
        solver = splu(csc_matrix(joined.C + 300 * rate), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        for _ in range(12):
            x = solver.solve(joined.C @ x + 300 * heat)
            out.append(seen @ x)
    return np.array(out)


def follows(small: FloatArray, exact: FloatArray) -> None:
    count = len(THERMAL_ERRORS) + 1
    assert abs(small - exact)[:, :count].max() < 1.0  # µm, µm/m
    assert np.sqrt(np.mean((small - exact)[:, :count] ** 2)) < 0.25
    assert abs(small - exact)[:, count:].max() < 0.25  # K


@pytest.mark.slow
def test_reduced_machines_follow_the_whole_ones() -> None:
    """The committed bodies of both machines."""
    exact = follow(join(machine_tables().machine, assemble_bodies(read_shape()), SparseSum))
    assert np.ptp(exact[:, 0]) > 10
    follows(follow(join(machine_tables().machine, reduced("base"))), exact)

    chosen = machine_tables("stiff")
    stiff = follow(join(chosen.machine, assemble_bodies(read_shape(chosen.shape)), SparseSum), "stiff")
    follows(follow(join(chosen.machine, reduced(chosen.reduced)), "stiff"), stiff)
    assert abs(stiff - exact)[:, : len(THERMAL_ERRORS)].max() > 2.0  # else this test could not tell them apart
