"""Offsets follow the workpiece point, consistently with what probing measures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from talc.frame import FloatArray
from talc.kinematics import axis_form, tcp_offsets, workpiece_growth
from talc.probing import design_matrix, rotation_x, rotation_z

angle = st.floats(-np.pi, np.pi)
errors9 = st.lists(st.floats(-50, 50), min_size=9, max_size=9).map(np.array)


@given(errors9, angle, angle)
def test_at_the_sphere_the_offsets_are_what_probing_would_measure(errors: FloatArray, a: float, c: float) -> None:
    radius, height = 0.2, 0.08
    tip_mm = rotation_x(a) @ rotation_z(c) @ np.array([radius, 0.0, height]) * 1e3
    probed = design_matrix(np.array([[a, c]]), radius, height) @ errors
    np.testing.assert_allclose(tcp_offsets(errors, np.array([*tip_mm, a, c]), radius), probed, atol=1e-9)


def test_hand_computed() -> None:
    # At A = 90° the table's up points to -Y, so its growth EZ0T moves the point there.
    errors = np.zeros(9)
    errors[4] = 7.0
    np.testing.assert_allclose(tcp_offsets(errors, np.array([0, 0, 0, np.pi / 2, 0.0]), 0.2), [0, -7, 0], atol=1e-12)
    # A tilt of 10 µm/m about Y lowers a point 0.1 m out in X by 1 µm.
    errors = np.zeros(9)
    errors[7] = 10.0
    np.testing.assert_allclose(tcp_offsets(errors, np.array([100.0, 0, 0, 0, 0]), 0.2), [0, 0, -1.0], atol=1e-12)
    # Radial growth of 8 µm at 0.2 m is 2 µm at 0.05 m, outwards.
    errors = np.zeros(9)
    errors[5] = 8.0
    np.testing.assert_allclose(tcp_offsets(errors, np.array([0, -50.0, 0, 0, 0]), 0.2), [0, -2.0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("errors", "positions", "radius"),
    [
        (np.zeros(8), np.zeros(5), 0.2),
        (np.full(9, np.nan), np.zeros(5), 0.2),
        (np.zeros(9), np.zeros(5), 0.0),
        (np.zeros(9), np.zeros(5), 150.0),
        (np.zeros(9), np.array([0.0, 0.0, 0.0, 90.0, 0.0]), 0.2),
    ],
)
def test_refuses_impossible_values(errors: FloatArray, positions: FloatArray, radius: float) -> None:
    with pytest.raises(ValueError, match=r"expected|finite"):
        tcp_offsets(errors, positions, radius)


def forward_chain(errors: FloatArray, positions: FloatArray, sphere_radius_m: float) -> FloatArray:
    """(3,) the deviation that `tcp_offsets` cancels, µm, by homogeneous transforms, without small-angle approximation.

    The workpiece point at the tool tip of the undisturbed machine is transformed from the table through C, A and their
    errors into machine coordinates. Arguments as `tcp_offsets`.
    """
    ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c = np.asarray(errors, dtype=np.float64) * 1e-6
    a, c = float(positions[3]), float(positions[4])
    tip = np.append(np.asarray(positions[:3], dtype=np.float64) * 1e-3, 1.0)
    at_a, at_c = _transform(rotation_x(a), np.zeros(3)), _transform(rotation_z(c), np.zeros(3))
    on_table = np.linalg.inv(at_a @ at_c) @ tip
    grown = on_table + np.array([*(on_table[:2] * er0t / sphere_radius_m), ez0t, 0.0])
    tilt = rotation_z(float(ec0c)) @ _rotation_y(float(eb0c)) @ rotation_x(float(ea0c))
    moved_a = _transform(np.eye(3), np.array([0.0, ey0a, ez0a])) @ at_a
    moved_c = _transform(tilt, np.array([ex0c, ey0c, 0.0])) @ at_c
    return np.asarray((moved_a @ moved_c @ grown - tip)[:3] / 1e-6, dtype=np.float64)


def _rotation_y(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _transform(rotation: FloatArray, shift: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, shift
    return matrix


travel = st.tuples(*[st.floats(-400, 400)] * 3).map(np.array)


@given(errors9, travel, angle, angle)
def test_small_angles_leave_less_than_a_nanometre_to_the_full_chain(
    errors: FloatArray, position: FloatArray, a: float, c: float
) -> None:
    positions = np.array([*position, a, c])
    # Second order: 50 µm/m by 50 µm/m over 0.7 m.
    np.testing.assert_allclose(tcp_offsets(errors, positions, 0.2), forward_chain(errors, positions, 0.2), atol=0.02)


@given(errors9, travel, travel, angle)
def test_the_axis_form_is_exact_for_one_position_of_a(
    errors: FloatArray, reference: FloatArray, position: FloatArray, a: float
) -> None:
    form = axis_form(errors, a, reference, 0.2)
    expected = tcp_offsets(errors, np.array([*position, a, 2.0]), 0.2)
    np.testing.assert_allclose(form.offsets(position), expected, atol=1e-8)


def test_slopes_by_hand() -> None:
    errors = np.zeros(9)
    errors[5], errors[8] = 20.0, 10.0  # radial growth of 20 µm at 0.2 m; C turned by 10 µm/m
    form = axis_form(errors, 0.0, np.array([100.0, 0.0, 0.0]), 0.2)
    np.testing.assert_allclose(form.k0, [10.0, 1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(form.slope, np.array([[0.1, -0.01, 0.0], [0.01, 0.1, 0.0], [0.0, 0.0, 0.0]]), atol=1e-9)


def test_workpiece_growth_by_hand() -> None:
    # 200 mm of aluminium, 3 K above 20 degC: 23.1e-6 * 3 * 200 mm = 13.86 µm away from where it is held.
    found = workpiece_growth(
        np.array([250.0, 0.0, 10.0]),
        np.array([50.0, 0.0, 10.0]),
        expansion_per_K=23.1e-6,
        temperature_degC=23.0,
        reference_degC=20.0,
    )
    np.testing.assert_allclose(found, [13.86, 0.0, 0.0], atol=1e-9)
    with pytest.raises(ValueError, match=r"expansion_per_K = 23\.1"):
        workpiece_growth(np.zeros(3), np.zeros(3), expansion_per_K=23.1, temperature_degC=23.0, reference_degC=20.0)
    with pytest.raises(ValueError, match="not finite"):
        workpiece_growth(np.zeros(3), np.zeros(3), expansion_per_K=1e-5, temperature_degC=np.nan, reference_degC=20.0)
    with pytest.raises(ValueError, match="reference has shape"):
        axis_form(np.zeros(9), 0.0, np.zeros(2), 0.2)
