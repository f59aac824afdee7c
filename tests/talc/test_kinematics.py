"""Offsets follow the workpiece point, consistently with what probing sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from talc.kinematics import tcp_offsets
from talc.probing import design_matrix, rotation_x, rotation_z

angle = st.floats(-np.pi, np.pi)
errors9 = st.lists(st.floats(-50, 50), min_size=9, max_size=9).map(np.array)


@given(errors9, angle, angle)
def test_at_the_sphere_the_offsets_are_what_probing_would_measure(
    errors: NDArray[np.float64], a: float, c: float
) -> None:
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
    [(np.zeros(8), np.zeros(5), 0.2), (np.full(9, np.nan), np.zeros(5), 0.2), (np.zeros(9), np.zeros(5), 0.0)],
)
def test_refuses_what_cannot_be(errors: NDArray[np.float64], positions: NDArray[np.float64], radius: float) -> None:
    with pytest.raises(ValueError, match=r"expected|finite"):
        tcp_offsets(errors, positions, radius)
