"""The probing equations against finite rotations, known ranks, and their stated noise."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from talc.probing import check_poses, design_matrix, report_poses, rotation_x, rotation_z, solve

SIX = np.deg2rad([[0, 0], [0, 90], [0, 180], [0, 270], [90, 0], [-90, 0]])
RADIUS, HEIGHT = 0.2, 0.08


def moved_sphere(errors: NDArray[np.float64], a: float, c: float) -> NDArray[np.float64]:
    """Centre's movement, µm, by finite transforms in metres: written independently of the equations under test."""
    e = errors * 1e-6
    ry = np.array([[math.cos(e[7]), 0, math.sin(e[7])], [0, 1, 0], [-math.sin(e[7]), 0, math.cos(e[7])]])
    tilt = rotation_z(e[8]) @ ry @ rotation_x(e[6])
    p = rotation_z(c) @ np.array([RADIUS, 0.0, HEIGHT])
    outward = np.array([math.cos(c), math.sin(c), 0.0])
    real = rotation_x(a) @ (tilt @ p + e[5] * outward + np.array([e[2], e[3], e[4]])) + np.array([0, e[0], e[1]])
    return np.asarray((real - rotation_x(a) @ p) * 1e6)


def test_six_poses_give_back_the_errors_that_moved_the_sphere() -> None:
    errors = np.array([3.0, -20.0, 45.0, 4.0, 25.0, 12.0, -30.0, 40.0, 15.0])
    deviations = np.array([moved_sphere(errors, a, c) for a, c in SIX])
    result = solve(deviations, SIX, radius_m=RADIUS, height_m=HEIGHT, sigma_um=1.0)
    # What is left is second order: 40 µm/m squared times 0.2 m is far below a nanometre.
    np.testing.assert_allclose(result.errors, errors, atol=0.01)
    assert result.residual_rms < 0.01
    assert result.rank == 9


def test_a_at_zero_alone_determines_seven() -> None:
    assert np.linalg.matrix_rank(design_matrix(SIX[:4], RADIUS, HEIGHT)) == 7
    with pytest.raises(ValueError, match=r"7 of 9.*EY0A, EZ0A, EY0C, EZ0T"):
        check_poses(SIX[:4], RADIUS, HEIGHT)


def test_condition_number_of_the_six_poses() -> None:
    assert check_poses(SIX, 0.15, 0.15) == pytest.approx(4.6, abs=0.05)


def test_reported_uncertainty_is_the_scatter_of_repeated_cycles() -> None:
    draw = np.random.default_rng(1)
    matrix = design_matrix(SIX, RADIUS, HEIGHT)
    truth = draw.normal(size=9) * 20
    found, sigma = [], np.zeros(9)
    for _ in range(800):
        deviations = (matrix @ truth + draw.normal(0.0, 1.5, 18)).reshape(6, 3)
        result = solve(deviations, SIX, radius_m=RADIUS, height_m=HEIGHT, sigma_um=1.5)
        found.append(result.errors)
        sigma = result.sigma
    np.testing.assert_allclose(np.std(found, axis=0), sigma, rtol=0.1)
    np.testing.assert_allclose(np.mean(found, axis=0), truth, atol=0.3)


def test_a_missed_pose_is_left_out_while_the_rank_stays() -> None:
    errors = np.arange(1.0, 10.0)
    deviations = (design_matrix(SIX, RADIUS, HEIGHT) @ errors).reshape(6, 3)
    deviations[1] = math.nan
    result = solve(deviations, SIX, radius_m=RADIUS, height_m=HEIGHT, sigma_um=1.0)
    np.testing.assert_allclose(result.errors, errors, atol=1e-9)
    deviations[4:] = math.nan
    with pytest.raises(ValueError, match="of 9"):
        solve(deviations, SIX, radius_m=RADIUS, height_m=HEIGHT, sigma_um=1.0)


def test_another_sphere_at_the_same_poses_has_its_own_equations() -> None:
    errors = np.arange(1.0, 10.0)
    for radius, height in ((0.2, 0.08), (0.15, 0.08), (0.15, 0.05), (0.2, 0.08)):
        deviations = (design_matrix(SIX, radius, height) @ errors).reshape(6, 3)
        result = solve(deviations, SIX, radius_m=radius, height_m=height, sigma_um=1.0)
        np.testing.assert_allclose(result.errors, errors, atol=1e-9)


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ValueError, match=r"deviations_um has shape \(5, 3\): expected \(6, 3\)"):
        solve(np.zeros((5, 3)), SIX, radius_m=RADIUS, height_m=HEIGHT, sigma_um=1.0)


@pytest.mark.slow
def test_a_report_says_what_poses_determine_and_how_well() -> None:
    flat = np.deg2rad(np.array([[0.0, c] for c in (0, 90, 180, 270)]))
    few = report_poses(flat, 0.2, 0.08, 1.0)
    assert few.rank == 7
    assert few.condition == np.inf
    assert {"EY0A", "EY0C"} <= set(few.inseparable)
    assert np.isinf(few.sigma[0])
    tiny = report_poses(np.array([[0.0, -1.1], [0.0, 1.3], [0.0, 2.4]]), 0.0008157361212418004, 37.52632382042245, 1.0)
    assert not np.isnan(tiny.sigma).any(), "rounding makes a variance negative here"
    whole = report_poses(np.vstack([flat, np.deg2rad([[90.0, 0.0], [-90.0, 0.0]])]), 0.2, 0.08, 1.0)
    assert (whole.rank, whole.inseparable) == (9, ())
    # The uncertainties are the scatter of what repeated noisy cycles say.
    draw = np.random.default_rng(0)
    poses = np.vstack([flat, np.deg2rad([[90.0, 0.0], [-90.0, 0.0]])])
    cycles = [
        solve(draw.normal(size=(6, 3)), poses, radius_m=0.2, height_m=0.08, sigma_um=1.0).errors for _ in range(3000)
    ]
    np.testing.assert_allclose(np.std(cycles, axis=0), whole.sigma, rtol=0.06)
    assert report_poses(np.zeros((0, 2)), 0.2, 0.08, 1.0).rank == 0


@pytest.mark.parametrize(
    ("poses", "radius_m", "height_m", "said"),
    [
        (np.array([[90.0, 0.0]]), 0.2, 0.08, "90 rad: expected radians"),
        (SIX, 150.0, 0.08, "radius_m = 150.0: expected metres"),
        (SIX, 0.15, 80.0, "height_m = 80.0: expected metres"),
        (SIX, 0.15, math.nan, "height_m = nan"),
    ],
)
def test_degrees_and_millimetres_are_refused(poses: np.ndarray, radius_m: float, height_m: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        design_matrix(poses, radius_m, height_m)
