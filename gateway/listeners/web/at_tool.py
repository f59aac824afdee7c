"""The error at the tool at one point of the work space: without compensation, with it, and how certain it is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.telemetry.subscriber.machine import Applied, Estimated
from talc.frame import FloatArray
from talc.indicators import TWO_SIDED_95
from talc.kinematics import tcp_offsets

_NOT_HERE = 1e-12
"""An error that moves the tool by less than this factor does not count at this point; it may be unknown."""


@dataclass(frozen=True, slots=True)
class WorkPoint:
    """A point of the work space: machine coordinates from where A and C meet, mm, and degrees."""

    x: float
    y: float
    z: float
    a: float = 0.0
    c: float = 0.0

    def matrix(self, sphere_radius_m: float) -> FloatArray:
        """(3, 9) deviation at the tool, µm, per unit of each thermal error: it is linear in them."""
        there = np.array([self.x, self.y, self.z, np.radians(self.a), np.radians(self.c)])
        return np.column_stack([tcp_offsets(unit, there, sphere_radius_m) for unit in np.eye(9)])


@dataclass(frozen=True, slots=True, eq=False)
class ToolError:
    """Deviations between tool and workpiece at one instant or at n, µm, X Y Z; NaN: unknown."""

    without: FloatArray
    """(3,) or (n, 3) without compensation."""
    left: FloatArray
    """(3,) or (n, 3) with what the control has in force."""
    half: FloatArray
    """(3,) or (n, 3) half of the 95 % interval of both."""

    @property
    def far(self) -> FloatArray:
        """The far end of the interval of what is left, without its sign."""
        return np.asarray(np.abs(self.left) + self.half, dtype=np.float64)

    @property
    def near(self) -> FloatArray:
        """The near end: at least this much is left."""
        return np.maximum(np.abs(self.left) - self.half, 0.0)


def told(error: ToolError) -> list[list[float]]:
    """What is left, half of its interval and its far end at one instant, (3,) each, to tenths of a micrometre.

    The far end is rounded up, so that what is beyond a tolerance is never written as within it, and the other two add
    up to it.
    """
    left, far = np.round(error.left, 1), np.ceil(np.round(10.0 * error.far, 6)) / 10.0
    return [left.tolist(), (far - np.abs(left)).tolist(), far.tolist()]


def moved(matrix: FloatArray, errors: FloatArray) -> FloatArray:
    """(..., 3) deviation at the tool of (..., 9) errors; an error that counts here and is unknown makes it NaN."""
    counted = [np.abs(row) > _NOT_HERE for row in matrix]
    return np.stack([errors[..., own] @ row[own] for row, own in zip(matrix, counted, strict=True)], axis=-1)


def half_width(matrix: FloatArray, sigma: FloatArray) -> FloatArray:
    """(..., 3) half of the 95 % interval at the tool, of (..., 9) standard uncertainties.

    The nine errors are taken to be independent of each other.
    """
    return np.asarray(TWO_SIDED_95 * np.sqrt(moved(matrix**2, sigma**2)), dtype=np.float64)


def at_the_tool(matrix: FloatArray, errors: FloatArray, sigma: FloatArray, now: Applied) -> ToolError:
    """(3, 9) matrix of a place, (9,) errors and their standard uncertainties, what the control has in force."""
    without = moved(matrix, errors)
    return ToolError(without, left_with(without, now), half_width(matrix, sigma))


def course(matrix: FloatArray, estimates: Sequence[Estimated]) -> ToolError:
    """The same of n > 0 estimates, each with what was in force then."""
    without = moved(matrix, np.stack([e.errors for e in estimates]))
    left = np.stack([left_with(each, e.applied) for each, e in zip(without, estimates, strict=True)])
    return ToolError(without, left, half_width(matrix, np.stack([e.sigma for e in estimates])))


def left_with(without: FloatArray, now: Applied) -> FloatArray:
    """(..., 3) what is left of the deviations at the tool, if the control continues as now."""
    if not now.following:
        return np.asarray(without - np.array(now.offsets_um), dtype=np.float64)
    # The control takes back the estimate at every point, apart from what the slew holds back still. How much the bound
    # withholds at this point is not published.
    unknown = np.isnan(without) | np.array(now.bounded)
    return np.where(unknown, np.nan, np.array(now.to_come_um))
