"""The Jacobian of any chain against an exact product of transforms, and against the nine errors of the method."""

import numpy as np
import pytest

from talc.chain import Machine, chain_of, unit_of
from talc.kinematics import CHAIN, offset_matrix
from talc.names import ERROR_UNITS, THERMAL_ERRORS
from talc.probing import design_matrix
from tests.benches.exact_chain import PROBE_M, RADIUS_M, exact_deviation

CHAINS = (
    "w C' A' X' b Y Z S t",
    "w C' B' Y' b X Z S t",
    "w C' Y' b X Z B S t",
    "w X' b Y Z C A S t",
    "w B' Z' b X Y S t",
    "w X' Y' b Z S t",
)
ORIGINS = {"A": (0.01, -0.02, 0.03), "B": (-0.02, 0.01, 0.25), "C": (0.005, 0.02, 0.4)}
LEAST_UM = 0.003
"""First order: 10 µm and 10 µm/m in all errors at once over 0.7 m make some 0.001 µm of second order."""


def machine_of(chain: str) -> Machine:
    origins = {axis: at for axis, at in ORIGINS.items() if axis in chain}
    return Machine(chain_of(chain), origins, probe_m=PROBE_M, radius_m=RADIUS_M)


@pytest.mark.parametrize("chain", CHAINS)
def test_all_errors_at_once_move_the_tool_as_in_an_exact_product_of_transforms(chain: str) -> None:
    machine, draw = machine_of(chain), np.random.default_rng(51)
    origins = {axis: np.array(at) for axis, at in machine.origins_m.items()}
    largest = moved = 0.0
    for _ in range(1000):
        point, errors = draw.uniform(-0.4, 0.4, 3), draw.uniform(-10, 10, len(machine.errors))
        angles = draw.uniform(-1.6, 1.6, len(machine.chain.rotary))
        of = dict(zip(machine.chain.rotary, angles.tolist(), strict=True))
        exact = exact_deviation(chain, origins, dict(zip(machine.errors, errors.tolist(), strict=True)), point, of)
        largest = max(largest, float(np.linalg.norm(machine.jacobian(point, angles) @ errors - exact)))
        moved = max(moved, float(np.linalg.norm(exact)))
    assert moved > 20.0
    assert largest < LEAST_UM


def test_the_nine_errors_of_the_method_are_the_first_nine_of_its_chain() -> None:
    machine, draw = Machine(chain_of(CHAIN), radius_m=RADIUS_M), np.random.default_rng(9)
    assert machine.errors[:9] == THERMAL_ERRORS
    assert {error: unit_of(error) for error in THERMAL_ERRORS} == ERROR_UNITS
    for angles in draw.uniform(-3, 3, (100, 2)):
        sphere = machine.jacobian(np.array([RADIUS_M, 0.0, 0.08]), angles)
        np.testing.assert_allclose(sphere[:, :9], design_matrix(angles[None], RADIUS_M, 0.08), atol=1e-14)
        point = draw.uniform(-0.4, 0.4, 3)
        tip = np.array([*machine.linear(point, angles) * 1e3, *angles])
        np.testing.assert_allclose(machine.jacobian(point, angles)[:, :9], offset_matrix(tip, RADIUS_M), atol=1e-14)


def test_by_hand() -> None:
    mill = Machine(chain_of("w-X'-Y'-b-Z-S-t"), fixed_m={"X": -0.35})
    assert str(mill.chain) == "w-X'-Y'-b-Z-S-t"
    of = dict(zip(mill.errors, mill.jacobian(np.array([0.15, 0.1, -0.2]), np.zeros(0)).T, strict=True))
    np.testing.assert_allclose(of["EXX"], [-0.5, 0, 0], atol=1e-15)  # 1 µm/m over 0.5 m from the fixed bearing
    np.testing.assert_allclose(of["EC0Y"], [0.1, 0, 0], atol=1e-15)  # Y leans to -X
    np.testing.assert_allclose(of["EZ0S"], [0, 0, -1], atol=1e-15)
    against = Machine(chain_of(CHAIN), senses={"A": -1})
    np.testing.assert_allclose(against.linear(np.array([0, 0, 0.1]), np.array([np.pi / 2, 0])), [0, 0.1, 0], atol=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "X Y Z",
        "w C' A' X' b Y Z t",
        "w C A' X' b Y Z S t",
        "w C' b X Y Z' S t",
        "w X' b Y Y Z S t",
        "w C' B' A' b X Y Z S t",
        "w X' C' b Y Z S t",
        "w C' X' b Y S t",
        "w C' b X Y Z C S t",
        "w U' b X Y Z S t",
    ],
)
def test_what_is_no_chain_is_refused(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"expected|not covered"):
        chain_of(wrong)


def test_one_angle_for_each_rotary_axis() -> None:
    with pytest.raises(ValueError, match="expected"):
        Machine(chain_of(CHAIN)).jacobian(np.zeros(3), np.zeros(1))
