"""The form in which offsets go to a control: a shift for the present position, or one that follows the position.

Each is a matrix of coefficients (3, n), µm, rows X, Y, Z. The first column is the shift at the reference; the others
are the largest addition by each axis' position within its travel. So the sum of a row's magnitudes bounds the shift
everywhere, and the sum of the magnitudes of a change bounds the change everywhere.
"""

import math
from typing import Protocol

import numpy as np

from drivers.nc import FollowsPosition, LinearOffsets, NcSnapshot, NumericalControl, Triple
from gateway.nc.slew import Offsets, as_offsets
from gateway.probing import InForce
from talc import kinematics
from talc.frame import FloatArray

_SAME_UM = 0.05
"""Differences below this are rounding on the way to the control and back."""


class Form(Protocol):
    """The form of offsets for one control."""

    def basis(self, position_mm: FloatArray) -> FloatArray:
        """(..., n) for positions (..., 3): coefficients times this is the shift there."""
        ...

    def wanted(self, errors: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
        """(3, n) that cancels errors (9,) at positions (5,): X Y Z in mm, A C in rad."""
        ...

    def during(self, coefficients: FloatArray, centres_mm: FloatArray | None) -> InForce:
        """The shift in force when each of the sphere's centres (poses, 3) was touched: one for all, or one each."""
        ...

    async def read(self) -> FloatArray:
        """(3, n) in force. Raises DriverError."""
        ...

    async def write(self, coefficients: FloatArray) -> None:
        """Put (3, n) into force. Raises DriverError."""
        ...


def form_of(nc: NumericalControl) -> Form:
    """The best form that a control supports."""
    return OverTravel(nc) if isinstance(nc, FollowsPosition) else HereAndNow(nc)


class HereAndNow:
    """One shift of X, Y, Z, updated as the axes move: n = 1."""

    def __init__(self, nc: NumericalControl) -> None:
        self._nc = nc

    def basis(self, position_mm: FloatArray) -> FloatArray:
        return np.ones((*position_mm.shape[:-1], 1))

    def wanted(self, errors: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
        return kinematics.tcp_offsets(errors, positions, radius_m)[:, None]

    def during(self, coefficients: FloatArray, centres_mm: FloatArray | None) -> Offsets:
        del centres_mm
        return as_offsets(coefficients[:, 0])

    async def read(self) -> FloatArray:
        return np.array(await self._nc.read_compensation())[:, None]

    async def write(self, coefficients: FloatArray) -> None:
        await self._nc.write_compensation(as_offsets(coefficients[:, 0]))


class OverTravel:
    """K0 + tanβ (P - P0), with the slopes that the control can have: n = 4.

    The effect of missing slopes goes into K0 for the present position, so that the shift is complete there.
    """

    def __init__(self, nc: FollowsPosition) -> None:
        self._nc = nc
        self._reference, self._reach = np.array(nc.reference_mm), np.array(nc.reach_mm)
        self._can = np.zeros((3, 3))
        for shifted, over in nc.pairs:
            self._can[shifted, over] = 1.0

    def basis(self, position_mm: FloatArray) -> FloatArray:
        away = (position_mm - self._reference) / self._reach
        return np.concatenate([np.ones((*away.shape[:-1], 1)), away], axis=-1)

    def wanted(self, errors: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
        whole = kinematics.axis_form(errors, float(positions[3]), self._reference, radius_m)
        slope = whole.slope * self._can
        k0 = whole.offsets(positions[:3]) - slope @ (positions[:3] - self._reference)
        return np.column_stack([k0, slope * self._reach])

    def during(self, coefficients: FloatArray, centres_mm: FloatArray | None) -> InForce:
        if centres_mm is None:
            return as_offsets(coefficients[:, 0])
        return tuple(as_offsets(row) for row in self.basis(centres_mm) @ coefficients.T)

    async def read(self) -> FloatArray:
        now = await self._nc.read_linear()
        return np.column_stack([now.k0_um, np.array(now.slope_um_per_mm) * self._reach])

    async def write(self, coefficients: FloatArray) -> None:
        rows: list[Triple] = [as_offsets(row) for row in coefficients[:, 1:] / self._reach]
        slopes = rows[0], rows[1], rows[2]
        await self._nc.write_linear(LinearOffsets(as_offsets(coefficients[:, 0]), slopes, as_offsets(self._reference)))


def differ(found: FloatArray, wanted: FloatArray) -> bool:
    """Whether two matrices (3, n) differ somewhere in the travel."""
    # With the comparison the other way round, NaN would agree with everything.
    return not np.abs(found - wanted).sum(axis=1).max() <= _SAME_UM


def offsets_text(coefficients: FloatArray) -> str:
    """For a message, µm: rows X, Y, Z; several columns as K0 and the largest addition of each slope."""
    return " ".join("/".join(f"{v:.2f}" for v in row) for row in coefficients)


def positions(snapshot: NcSnapshot) -> FloatArray:
    """(5,) X Y Z in mm, A C in radians."""
    at = snapshot.positions
    return np.array([at["X"], at["Y"], at["Z"], math.radians(at["A"]), math.radians(at["C"])])
