"""One dry run: the cycle's path above the sphere, followed and judged."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from drivers.base import ConnectError, DriverError, Refused
from drivers.nc import AXES, NcSnapshot, NumericalControl, ProbingState, RequestStatus, Triple
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.nc.probing.cycle import NotBegun, Rejected, ended
from gateway.nc.probing.geometry import Geometry
from gateway.nc.probing.uninterrupted import to_its_end
from gateway.runtime.clocks import ServiceClock

_AT_POSE_DEG: Final = 0.5
_BESIDE_MM: Final = 30.0
"""Farthest from the sphere's centre, in X and Y, that a cycle ends a pose: a sphere's radius and the way to it."""
_ROUNDED_MM: Final = 1.0
_NEAREST: Final = 0.8
"""Of the height: no point of a path that was raised by it comes nearer to the sphere's centre than the height,"""
_TOUCHES_MM: Final = 40.0
"""and no path that was not raised stays so far away from it at every pose."""


@dataclass(frozen=True, slots=True)
class PosePath:
    """What was seen of a dry run at one pose."""

    a_deg: float
    c_deg: float
    reached_mm: Triple
    """Where the control says that it was."""
    aside_mm: float
    """How far that is from over the sphere's centre, in X and Y."""
    above_mm: float
    """How far above the sphere's centre."""
    nearest_mm: float
    """Shortest distance of the tip from the sphere's centre among the samples at this pose; NaN: there was none."""
    seconds: float
    """How long the samples at this pose lasted."""


@dataclass(frozen=True, slots=True)
class DryRun:
    """A dry run that came to its end."""

    height_mm: float
    seconds: float
    poses: tuple[PosePath, ...]
    ranges: dict[str, tuple[float, float]]
    """Axis to the lowest and the highest position that was sampled, mm and degrees."""
    samples: int

    @property
    def wrong(self) -> tuple[str, ...]:
        """Why it does not show that the cycle is free; empty: it does."""
        return tuple(_wrong(self))


def _wrong(run: DryRun) -> Sequence[str]:
    found = []
    for number, pose in enumerate(run.poses, start=1):
        where = "is the sphere where [probing] says, and does the control's program have these poses?"
        if pose.aside_mm > _BESIDE_MM:
            found.append(f"pose {number}: {pose.aside_mm:.1f} mm beside the sphere that [probing] gives: {where}")
        if not abs(pose.above_mm - run.height_mm) <= _ROUNDED_MM:
            found.append(
                f"pose {number}: {pose.above_mm:.1f} mm above the sphere's centre, not {run.height_mm:g}: {where} Was "
                "origin_mm found with the probe in the spindle?"
            )
    return found


async def run_dry(
    nc: NumericalControl,
    number: int,
    geometry: Geometry,
    clock: ServiceClock,
    *,
    height_mm: float,
    poll_s: float,
    timeout_s: float,
    told: Callable[[ProbingState], None],
) -> DryRun:
    """Request dry run `number` and follow it to its end. told: each state as it begins.

    Withdraws it when it comes too near to the sphere, takes longer than `timeout_s`, is cancelled, or the connection
    breaks. Raises NotBegun, Rejected or DriverError.
    """
    began_s, seen, state = clock.monotonic(), list[NcSnapshot](), ProbingState.IDLE
    over = False
    try:
        with clock.hold():
            try:
                await to_its_end(nc.request_probing(number, height_mm))
            except Refused:
                over = True  # it has not taken the request; without an answer it may have
                raise
        while True:
            await clock.sleep_until(clock.monotonic() + poll_s)
            with clock.hold():
                status = await to_its_end(nc.probing_status(number))
                snapshot = await to_its_end(nc.snapshot())
            if status.state is not state:
                state = status.state
                told(state)
            if over := ended(status):
                return _judged(status, geometry, seen, height_mm, clock.monotonic() - began_s)
            if state is ProbingState.RUNNING and snapshot.probing is not False:
                seen.append(snapshot)
                distance = _distance_mm(snapshot, geometry)
                if distance < min(_NEAREST * height_mm, _TOUCHES_MM):
                    raise Rejected(Text(NoticeCode.DRY_RUN_TOO_NEAR, distance_mm=distance, height_mm=height_mm))
            if clock.monotonic() - began_s > timeout_s:
                text = Text(NoticeCode.DRY_RUN_NOT_ENDED, timeout_s=timeout_s)
                raise Rejected(text) if seen else NotBegun(text)
    finally:
        if not over:
            with clock.hold():
                await to_its_end(_withdraw(nc, number))


async def _withdraw(nc: NumericalControl, number: int) -> None:
    """Also when the connection has broken: once more through another one. Raises ConnectError if that fails too."""
    try:
        await nc.withdraw_probing(number)
    except DriverError:
        try:
            await nc.close()
            await nc.connect()
            await nc.withdraw_probing(number)
        except DriverError as error:
            hint = Text(NoticeCode.DRY_RUN_STOP, number=number)
            what = Text(NoticeCode.DRY_RUN_GOES_ON, number=number, error=error.advice)
            raise ConnectError(what, device="nc", hint=hint) from error


def _judged(
    status: RequestStatus, geometry: Geometry, seen: Sequence[NcSnapshot], height_mm: float, seconds: float
) -> DryRun:
    reached = status.centres_mm or ()
    if len(reached) != len(geometry.poses_deg):
        raise Rejected(Text(NoticeCode.DRY_RUN_POSITIONS, n=len(reached), expected=len(geometry.poses_deg)))
    poses = []
    for (a, c), at in zip(geometry.poses_deg, reached, strict=True):
        x, y, z = geometry.centre_mm(a, c)
        there = [snapshot for snapshot in seen if _is_at(snapshot, a, c)]
        nearest = min((_distance_mm(snapshot, geometry) for snapshot in there), default=math.nan)
        lasted = there[-1].monotonic_s - there[0].monotonic_s if there else 0.0
        poses.append(PosePath(a, c, at, math.hypot(at[0] - x, at[1] - y), at[2] - z, nearest, lasted))
    each = {axis: [snapshot.positions[axis] for snapshot in seen] for axis in AXES}
    ranges = {axis: (min(values), max(values)) for axis, values in each.items() if values}
    return DryRun(height_mm, seconds, tuple(poses), ranges, len(seen))


def _distance_mm(snapshot: NcSnapshot, geometry: Geometry) -> float:
    at = snapshot.positions
    return math.dist([at[axis] for axis in "XYZ"], geometry.centre_mm(at["A"], at["C"]))


def _is_at(snapshot: NcSnapshot, a_deg: float, c_deg: float) -> bool:
    at = snapshot.positions
    turned = (at["C"] - c_deg + 180.0) % 360.0 - 180.0
    return abs(at["A"] - a_deg) < _AT_POSE_DEG and abs(turned) < _AT_POSE_DEG
