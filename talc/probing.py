"""Probing equations: from the sphere's centres at several poses to the nine thermal errors, and back.

The sphere stands on the table at p0 = (R, 0, h) in the C frame. At pose (a, c) its centre moves, for small errors, by

    delta = (0, EY0A, EZ0A)
          + Rx(a) [ (EX0C, EY0C, 0) + (EA0C, EB0C, EC0C) x Rz(c) p0 + ER0T Rz(c) e_x + EZ0T e_z ]

which is linear in the nine errors: each pose gives three equations.

Examples
--------
Six poses, the sphere 150 mm from the C axis and 80 mm above the table; which errors do they tell apart, and how well?

>>> import numpy as np
>>> from talc import probing
>>> poses = np.radians([(0, 0), (0, 90), (0, 180), (0, 270), (-45, 0), (-45, 90)])
>>> report = probing.report_poses(poses, radius_m=0.15, height_m=0.08, sigma_um=0.5)
>>> report.rank, report.inseparable
(9, ())
>>> errors = np.array([10, 30, 5, 0, 12, 8, 0, 20, 0])  # µm; the last three µm/m
>>> moved = (probing.design_matrix(poses, 0.15, 0.08) @ errors).reshape(6, 3)
>>> found = probing.solve(moved, poses, radius_m=0.15, height_m=0.08, sigma_um=0.5)
>>> bool(np.allclose(found.errors, errors))
True
"""

import math
from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray
from talc.names import THERMAL_ERRORS

_RANK_TOLERANCE = 1e-9
MOST_RAD = 4 * math.pi
"""Angles beyond two turns are most likely degrees."""
FARTHEST_M, HIGHEST_M = 10.0, 40.0
"""Radii and heights beyond these are most likely millimetres."""
_NO_CHECK = 1e-6
"""A coordinate with less than this share left to its residual is not checked by the others."""


@dataclass(frozen=True, slots=True)
class ProbingResult:
    """The nine errors of one cycle."""

    errors: FloatArray
    """(9,) µm, µm/m for the last three."""
    sigma: FloatArray
    """(9,) standard uncertainties, same units."""
    residual_rms: float
    """RMS of what the errors do not explain, µm."""
    rank: int
    standardised: FloatArray
    """(n, 3) residuals in units of their own standard deviation, sigma·sqrt(1 - leverage), so that a single wrong
    coordinate stands out equally wherever it is; NaN: not measured, 0: no other coordinate can check it."""


def refuse_millimetres(name: str, size_m: float, most_m: float) -> None:
    """ValueError: a size is not finite, or so large that it is most likely in mm."""
    if not abs(size_m) <= most_m:
        raise ValueError(f"{name} = {size_m!r}: expected metres, at most {most_m:g}; 150 mm are 0.15")


def rotation_x(angle: float) -> FloatArray:
    """(3, 3) rotation about X by `angle` radians."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_z(angle: float) -> FloatArray:
    """(3, 3) rotation about Z by `angle` radians."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def deviation_matrix(a: float, point_c_m: FloatArray, radial: FloatArray) -> FloatArray:
    """(3, 9) deviation in machine axes (µm) per unit of each error (µm, µm/m) of a point on the table.

    a: A position, rad; point_c_m: (3,) the point in the A frame after the C rotation, metres from the centre of the
    rotary axes; radial: (3,) direction of the table's radial growth there, scaled with the share of ER0T.
    """
    x, y, z = (float(v) for v in point_c_m)
    inner = np.zeros((3, 9))
    inner[:, 2] = (1.0, 0.0, 0.0)  # EX0C
    inner[:, 3] = (0.0, 1.0, 0.0)  # EY0C
    inner[:, 4] = (0.0, 0.0, 1.0)  # EZ0T
    inner[:, 5] = radial  # ER0T
    inner[:, 6] = (0.0, -z, y)  # EA0C: e_x x p
    inner[:, 7] = (z, 0.0, -x)  # EB0C: e_y x p
    inner[:, 8] = (-y, x, 0.0)  # EC0C: e_z x p
    matrix = rotation_x(a) @ inner
    matrix[:, 0] = (0.0, 1.0, 0.0)  # EY0A
    matrix[:, 1] = (0.0, 0.0, 1.0)  # EZ0A
    return matrix


def design_matrix(poses_rad: FloatArray, radius_m: float, height_m: float) -> FloatArray:
    """(3 n, 9) deviations of the sphere's centre per unit of each error; rows X, Y, Z of the first pose, then the next.

    poses_rad: (n, 2) A and C; radius_m, height_m: the sphere in the C frame, metres. ValueError: another shape, or
    sizes that only degrees and millimetres have.
    """
    poses = np.asarray(poses_rad, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 2 or not np.isfinite(poses).all():
        raise ValueError(f"poses_rad has shape {poses.shape}: expected (n, 2) finite angles A, C")
    if (np.abs(poses) > MOST_RAD).any():
        largest = float(np.abs(poses).max())
        raise ValueError(f"poses_rad holds an angle of {largest:g} rad: expected radians; np.radians converts degrees")
    refuse_millimetres("radius_m", radius_m, FARTHEST_M)
    refuse_millimetres("height_m", height_m, HIGHEST_M)
    blocks = []
    for a, c in poses:
        rz = rotation_z(c)
        blocks.append(deviation_matrix(a, rz @ np.array([radius_m, 0.0, height_m]), rz[:, 0]))
    return np.vstack(blocks) if blocks else np.zeros((0, 9))


@dataclass(frozen=True, slots=True)
class PoseReport:
    """What a set of poses can determine."""

    rank: int
    """Rank of the equations, at most 9."""
    condition: float
    """Condition number of the scaled equations (errors in µm, angles as arcs at the sphere); infinite below rank 9."""
    sigma: FloatArray
    """(9,) standard uncertainty of each error, µm and µm/m; infinite where the poses do not determine it."""
    inseparable: tuple[str, ...]
    """The errors that they do not determine."""


def report_poses(poses_rad: FloatArray, radius_m: float, height_m: float, sigma_um: float) -> PoseReport:
    """Rank, condition and uncertainties of any pose set. sigma_um: standard uncertainty of one coordinate."""
    design = design_matrix(poses_rad, radius_m, height_m)
    _, values, rows = np.linalg.svd(_scaled(design, radius_m))
    full = np.zeros(9)
    full[: values.size] = values
    rank = int((full > _RANK_TOLERANCE * full[0]).sum()) if full[0] > 0 else 0
    loose = (rows[rank:] ** 2).sum(axis=0) > 1e-6
    variance = np.diag(np.linalg.pinv(design.T @ design))
    spread = np.sqrt(np.maximum(variance, 0.0)) * sigma_um  # rounding makes 0 of a loose error negative
    return PoseReport(
        rank=rank,
        condition=float(full[0] / full[-1]) if rank == 9 else math.inf,
        sigma=np.where(loose, np.inf, spread),
        inseparable=tuple(n for n, is_loose in zip(THERMAL_ERRORS, loose, strict=True) if is_loose),
    )


def check_poses(poses_rad: FloatArray, radius_m: float, height_m: float) -> float:
    """Condition number of the pose set (errors in µm, angles scaled with the radius).

    Raises ValueError naming the rank and the errors that the poses do not determine.
    """
    report = report_poses(poses_rad, radius_m, height_m, 1.0)
    if report.rank < 9:
        raise ValueError(
            f"the poses determine {report.rank} of 9 errors; not separable: {', '.join(report.inseparable)}. "
            "Add poses with A away from 0"
        )
    return report.condition


def solve(
    deviations_um: FloatArray, poses_rad: FloatArray, *, radius_m: float, height_m: float, sigma_um: float
) -> ProbingResult:
    """Nine errors from the sphere's deviations by least squares.

    deviations_um: (n, 3) movement of the sphere's centre since the reference, µm; a row with NaN is a pose that was
    not measured. sigma_um: standard uncertainty of one coordinate.
    Raises ValueError for wrong shapes and when the measured poses do not determine all nine.
    """
    deviations = np.asarray(deviations_um, dtype=np.float64)
    poses = np.asarray(poses_rad, dtype=np.float64)
    if deviations.shape != (len(poses), 3):
        raise ValueError(f"deviations_um has shape {deviations.shape}: expected ({len(poses)}, 3), one row per pose")
    measured = np.isfinite(deviations).all(axis=1)
    check_poses(poses[measured], radius_m, height_m)
    matrix = design_matrix(poses[measured], radius_m, height_m)
    y = deviations[measured].ravel()
    errors, *_ = np.linalg.lstsq(matrix, y, rcond=None)
    covariance = np.linalg.inv(matrix.T @ matrix) * sigma_um**2
    residual = y - matrix @ errors
    free = 1.0 - np.einsum("ij,jk,ik->i", matrix, covariance, matrix) / sigma_um**2
    standardised = np.full(deviations.shape, np.nan)
    known = np.where(free > _NO_CHECK, residual / (sigma_um * np.sqrt(np.maximum(free, _NO_CHECK))), 0.0)
    standardised[measured] = known.reshape(-1, 3)
    return ProbingResult(
        np.asarray(errors, dtype=np.float64),
        np.sqrt(np.diag(covariance)),
        float(np.sqrt(np.mean(residual**2))),
        9,
        standardised,
    )


def _scaled(matrix: FloatArray, radius_m: float) -> FloatArray:
    """Angles as the arc that they make at the sphere, so that all columns are in µm per µm."""
    scale = np.ones(9)
    scale[6:] = 1.0 / radius_m
    return matrix * scale
