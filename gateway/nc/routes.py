"""The form in which offsets go to a control.

It is a shift for the present position, a shift that follows the position, or the nine errors themselves.

Each is a matrix of coefficients (3, n), µm, rows X, Y, Z. The first column is the shift at the reference; the others
are the largest addition by each axis' position within its travel; or each column is the largest shift by one error. So
the sum of a row's magnitudes bounds the shift everywhere, and the sum of the magnitudes of a change bounds the change
everywhere.
"""

import math
from typing import Protocol

import numpy as np

from drivers.nc import (
    FollowsErrors,
    FollowsPosition,
    LinearOffsets,
    NcSnapshot,
    NineErrors,
    NumericalControl,
    TakesSlopes,
    Triple,
)
from gateway.model.compensation import Offsets
from gateway.model.probing import InForce
from gateway.nc.slew import as_offsets
from talc import kinematics
from talc.frame import FloatArray

_SAME_UM = 0.05
"""Differences below this are rounding on the way to the control and back."""


class Form(Protocol):
    """The form of offsets for one control."""

    @property
    def together(self) -> bool:
        """Whether the rows move in proportion only, and the control bounds the offsets itself; see Slew."""
        ...

    def basis(self, positions: FloatArray) -> FloatArray:
        """(n,), or (3, n) for each row its own: coefficients times this, summed, is the shift at positions (5,)."""
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


def form_of(nc: NumericalControl, radius_m: float, bound_um: Triple) -> Form:
    """The best form that a control supports.

    radius_m: of the sphere, where ER0T is; bound_um: the bound of a control that computes the offsets itself.
    """
    if isinstance(nc, FollowsPosition):
        return OverTravel(nc)
    return AgentRoute(nc, radius_m, bound_um) if isinstance(nc, FollowsErrors) else HereAndNow(nc)


class HereAndNow:
    """One shift of X, Y, Z, updated as the axes move: n = 1."""

    def __init__(self, nc: NumericalControl) -> None:
        self._nc = nc

    together = False

    def basis(self, positions: FloatArray) -> FloatArray:
        del positions
        return np.ones(1)

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

    def __init__(self, nc: TakesSlopes) -> None:
        self._nc = nc
        self._reference, self._reach = np.array(nc.reference_mm), np.array(nc.reach_mm)
        self._can = np.zeros((3, 3))
        for shifted, over in nc.pairs:
            self._can[shifted, over] = 1.0

    together = False

    def basis(self, positions: FloatArray) -> FloatArray:
        return self._over(positions[:3])

    def _over(self, position_mm: FloatArray) -> FloatArray:
        """(..., n) for (..., 3)."""
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
        return tuple(as_offsets(row) for row in self._over(centres_mm) @ coefficients.T)

    async def read(self) -> FloatArray:
        now = await self._nc.read_linear()
        return np.column_stack([now.k0_um, np.array(now.slope_um_per_mm) * self._reach])

    async def write(self, coefficients: FloatArray) -> None:
        rows: list[Triple] = [as_offsets(row) for row in coefficients[:, 1:] / self._reach]
        slopes = rows[0], rows[1], rows[2]
        await self._nc.write_linear(LinearOffsets(as_offsets(coefficients[:, 0]), slopes, as_offsets(self._reference)))


class ByErrors:
    """The nine errors, from which the control computes the shift wherever the tool is: n = 9, one column an error.

    reach_mm: of the tool from where A and C meet, along X and across it
    """

    together = True

    def __init__(self, nc: FollowsErrors, reach_mm: tuple[float, float], radius_m: float, bound_um: Triple) -> None:
        self._nc, self._radius_m, self._bound_um = nc, radius_m, bound_um
        self._largest = kinematics.largest_offsets((reach_mm[0] * 1e-3, reach_mm[1] * 1e-3), radius_m)

    def basis(self, positions: FloatArray) -> FloatArray:
        here = kinematics.offset_matrix(positions, self._radius_m)
        share = np.divide(here, self._largest, out=np.zeros_like(here), where=self._largest > 0)
        return np.asarray(share, dtype=np.float64)

    def wanted(self, errors: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
        del positions, radius_m
        return np.asarray(self._largest * errors, dtype=np.float64)

    def during(self, coefficients: FloatArray, centres_mm: FloatArray | None) -> Offsets:
        """At the origin: with the result, the control itself reports the shift that stood still during the cycle."""
        del centres_mm
        return as_offsets((coefficients * self.basis(np.zeros(5))).sum(axis=1))

    async def read(self) -> FloatArray:
        return self._largest * np.array(await self._nc.read_errors(self._radius_m * 1e3), dtype=np.float64)

    def errors_of(self, coefficients: FloatArray) -> FloatArray:
        """(9,) µm and µm/m that these coefficients (3, 9) stand for."""
        row = np.argmax(self._largest, axis=0)
        each = np.arange(len(row))
        return np.asarray(coefficients[row, each] / self._largest[row, each], dtype=np.float64)

    async def write(self, coefficients: FloatArray) -> None:
        errors = tuple(self.errors_of(coefficients).tolist())
        await self._nc.write_errors(NineErrors(errors, self._radius_m * 1e3, self._bound_um))


class AgentRoute:
    """Takes the form that the connected control accepts: the nine errors, slopes, or only a shift."""

    def __init__(self, nc: FollowsErrors, radius_m: float, bound_um: Triple) -> None:
        self._nc, self._radius_m, self._bound_um = nc, radius_m, bound_um
        self._shift = HereAndNow(nc)

    @property
    def _form(self) -> Form:
        reach, slopes = self._nc.error_reach_mm, self._nc.slopes
        if reach is not None:
            return ByErrors(self._nc, reach, self._radius_m, self._bound_um)
        return self._shift if slopes is None else OverTravel(slopes)

    @property
    def together(self) -> bool:
        return self._form.together

    def basis(self, positions: FloatArray) -> FloatArray:
        return self._form.basis(positions)

    def wanted(self, errors: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
        return self._form.wanted(errors, positions, radius_m)

    def during(self, coefficients: FloatArray, centres_mm: FloatArray | None) -> InForce:
        return self._form.during(coefficients, centres_mm)

    async def read(self) -> FloatArray:
        return await self._form.read()

    async def write(self, coefficients: FloatArray) -> None:
        await self._form.write(coefficients)


def differ(found: FloatArray, wanted: FloatArray, moved_um: float = 0.0) -> bool:
    """Whether two matrices (3, n) differ somewhere in the travel by more than `moved_um`; those of two forms do."""
    if found.shape != wanted.shape:
        return True
    # With the comparison the other way round, NaN would agree with everything.
    return not np.abs(found - wanted).sum(axis=1).max() <= _SAME_UM + moved_um


def offsets_text(coefficients: FloatArray) -> str:
    """For a message, µm: rows X, Y, Z; several columns as K0 and the largest addition of each slope."""
    return " ".join("/".join(f"{v:.2f}" for v in row) for row in coefficients)


def positions(snapshot: NcSnapshot) -> FloatArray:
    """(5,) X Y Z in mm, A C in radians; A within half a turn, though an axis may count many."""
    at = snapshot.positions
    a_deg = math.remainder(at["A"], 360.0) if math.isfinite(at["A"]) else at["A"]
    return np.array([at["X"], at["Y"], at["Z"], math.radians(a_deg), math.radians(at["C"])])
