"""The three-body machine against closed forms, against a finer mesh, and the reduced model against the whole one."""

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import eigsh, splu
from skfem import Basis, ElementHex2, ElementVector, LinearForm, condense, solve
from skfem.helpers import div
from skfem.models.elasticity import lame_parameters, linear_elasticity

from simulators.three_body import DRIFTS, load_reduced
from simulators.three_body.generate import reduce_whole
from simulators.three_body.solid import TOOL, WORKPIECE, Solid, assemble, mesh

VOLUME = 1 * 0.8 * 0.3 + 0.6 * 0.25 * 1.1 + 0.2 * 0.5 * 0.4
# Joined faces cancel the column's top against its footprint and the spindle's front against its seat.
SURFACE = 2 * (1 * 0.8 + 1 * 0.3 + 0.8 * 0.3) + 2 * (0.6 + 0.25) * 1.1 + 2 * (0.5 * 0.4 + 0.5 * 0.2)
LUMPED_s = 7850 * 434 * VOLUME / (5 * SURFACE)


@pytest.fixture(scope="module")
def coarse() -> Solid:
    return assemble(0.3)


@pytest.fixture(scope="module")
def whole() -> Solid:
    return assemble()


def steady(solid: Solid, watts: ArrayLike) -> np.ndarray:
    """watts: of each source, (2,), or (2, n) for n loads."""
    return np.asarray(splu(csc_matrix(solid.K + solid.H)).solve(solid.S @ np.array(watts)))


@pytest.mark.slow
def test_mass_surface_and_sources_are_the_bodies(coarse: Solid) -> None:
    assert coarse.C.sum() == pytest.approx(7850 * 434 * VOLUME, rel=1e-9)
    assert coarse.H.sum() == pytest.approx(5 * SURFACE, rel=1e-9)
    assert coarse.S.sum(axis=0) == pytest.approx([1, 1], rel=1e-12)
    assert abs(coarse.K @ np.ones(coarse.K.shape[0])).max() < 1e-9  # an evenly warm body conducts nothing


@pytest.mark.slow
def test_in_the_end_the_skin_gives_off_what_the_sources_bring(coarse: Solid) -> None:
    assert (coarse.H @ steady(coarse, (150, 90))).sum() == pytest.approx(240, rel=1e-9)


@pytest.mark.slow
def test_slowest_time_constant_is_the_lumped_one_and_a_little_more(coarse: Solid) -> None:
    rate = eigsh(coarse.K + coarse.H, k=1, M=coarse.C, sigma=0, which="LM", return_eigenvectors=False)[0]
    assert 1.0 < 1 / rate / LUMPED_s < 1.03  # Biot number well below 1
    assert LUMPED_s / 3600 == pytest.approx(16.35, abs=0.01)


@pytest.mark.slow
def test_mirror_symmetry(coarse: Solid) -> None:
    order = np.lexsort(np.round(coarse.nodes, 9))
    mirrored = coarse.nodes * np.array([[-1], [1], [1]]) + np.array([[1], [0], [0]])
    back = np.lexsort(np.round(mirrored, 9))
    rows = coarse.D[: len(DRIFTS)]
    size = abs(rows).max()
    assert abs(rows[0, order] + rows[0, back]).max() < 1e-8 * size
    assert abs(rows[1:, order] - rows[1:, back]).max() < 1e-8 * size


@pytest.mark.slow
def test_even_warming_of_the_unstrained_machine_opens_the_gap_by_its_free_growth() -> None:
    growth = assemble(0.3, free=True).D[: len(DRIFTS)].sum(axis=1)
    assert growth == pytest.approx([0, 0, 12e-6 * 0.5 * 1e6], abs=1e-6)  # 0.5 m between workpiece and tool


@pytest.mark.slow
def test_ordinary_elastic_solve_with_clamped_feet_gives_the_drift_of_the_adjoint_rows(coarse: Solid) -> None:
    """Stress-strain law and solver of scikit-fem's own, steel in Pa, displacements of every node, then the gap."""
    cells = mesh(0.3)
    heat = Basis(cells, ElementHex2(), intorder=4)
    motion = Basis(cells, ElementVector(ElementHex2()), intorder=4)
    warmth = steady(coarse, (150, 90))
    young, poisson = 210e9, 0.3
    stress = young / (1 - 2 * poisson) * 12e-6  # per K, hydrostatic
    swell = LinearForm(lambda v, w: stress * w["warmth"] * div(v)).assemble(motion, warmth=heat.interpolate(warmth))
    stiffness = linear_elasticity(*lame_parameters(young, poisson)).assemble(motion)
    x, y, z = np.asarray(motion.doflocs)
    foot = (z < 1e-9) & ((x < 0.1 + 1e-9) | (x > 0.9 - 1e-9)) & ((y < 0.1 + 1e-9) | (y > 0.7 - 1e-9))
    moved = solve(*condense(stiffness, swell, D=np.flatnonzero(foot)))
    tool, workpiece = (
        moved[np.abs(np.asarray(motion.doflocs) - np.array(place)[:, None]).max(axis=0) < 1e-9]
        for place in (TOOL, WORKPIECE)
    )
    assert coarse.D[: len(DRIFTS)] @ warmth == pytest.approx(1e6 * (tool - workpiece), rel=1e-6, abs=1e-6)


def test_zero_order_hold_does_not_depend_on_the_step() -> None:
    heat = np.random.default_rng(1).uniform(0, [150, 90], (60, 2))
    drift, sensors = load_reduced().respond(heat, 300.0)
    fine_drift, fine_sensors = load_reduced().respond(np.repeat(heat, 5, axis=0), 60.0)
    assert np.allclose(drift, fine_drift[4::5], atol=1e-9)
    assert np.allclose(sensors, fine_sensors[4::5], atol=1e-9)


def test_bad_heat_and_step_are_named() -> None:
    with pytest.raises(ValueError, match=r"heat: expected \(steps, 2\)"):
        load_reduced().respond(np.zeros((5, 3)))
    with pytest.raises(ValueError, match="dt_s"):
        load_reduced().respond(np.zeros((5, 2)), 0.0)


@pytest.mark.slow
def test_committed_matrices_are_the_generators_and_follow_the_whole_model(whole: Solid) -> None:
    rebuilt, stored = reduce_whole(whole), load_reduced()
    heat = np.repeat(np.random.default_rng(2).uniform(0, [150, 90], (8, 2)), 6, axis=0)  # 4 h, new loads each 30 min
    drift, sensors = stored.respond(heat)
    again, _ = rebuilt.respond(heat)
    assert abs(drift - again).max() < 1e-6
    # The whole model by the two-stage L-stable SDIRK (Alexander 1977), 60 s: second order, another way than expm.
    part, gamma = 60.0, 1 - np.sqrt(0.5)
    factor = splu(csc_matrix(whole.C + gamma * part * (whole.K + whole.H)))
    state = np.zeros(whole.C.shape[0])
    for k, q in enumerate(heat):
        for _ in range(5):
            load_w = whole.S @ q
            one = factor.solve(load_w - (whole.K + whole.H) @ state)
            two = factor.solve(load_w - (whole.K + whole.H) @ (state + part * (1 - gamma) * one))
            state = state + part * ((1 - gamma) * one + gamma * two)
        outputs = whole.D @ state
        assert abs(outputs[:3] - drift[k]).max() < 0.02
        assert abs(outputs[3:] + 20 - sensors[k]).max() < 0.02
    end = whole.D @ steady(whole, (150, 90))
    assert abs(end - stored.steady(np.array([150.0, 90.0]))).max() < 0.02


@pytest.mark.slow
def test_finer_meshes_converge(coarse: Solid, whole: Solid) -> None:
    far, near, fine = ((s.D @ steady(s, np.diag([150.0, 90.0])))[:3] for s in (coarse, assemble(0.2), whole))
    assert abs(near - fine).max() < 0.5 * abs(far - fine).max()
    assert abs(near - fine).max() < 0.02 * abs(fine).max()
