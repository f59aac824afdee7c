"""Positions of the axes, and the tool in the spindle, while the emulated control's program or its cycle runs."""

import math

import numpy as np

from simulators.nc.cycle import CycleSettings
from simulators.nc.program import Activity, DayPart, LoadCase, MeanLoads

AXIS_LETTERS = ("X", "Y", "Z", "A", "C")

_CENTRE_MM = {"X": 0.0, "Y": 0.0, "Z": 150.0}
_STROKE_MM = {"X": 300.0, "Y": 300.0, "Z": 200.0}
_A_STROKE_DEG = 120.0
_OVER_MM = 60.0
"""How far above the highest place of the sphere's centre the axes go from pose to pose."""


def positions_at(block: DayPart, time_s: float) -> dict[str, float]:
    """X Y Z in mm, A C in degrees: axes move back and forth at their mean speed; C turns."""
    since = max(0.0, time_s - block.start_s)
    loads = block.loads
    positions = {
        axis: _CENTRE_MM[axis] + _triangle(speed / 60.0 * since, _STROKE_MM[axis])
        for axis, speed in (("X", loads.x), ("Y", loads.y), ("Z", loads.z))
    }
    positions["A"] = _triangle(loads.a * 6.0 * since, _A_STROKE_DEG)
    positions["C"] = math.fmod(loads.c * 6.0 * since, 360.0)
    return positions


def _triangle(path: float, stroke: float) -> float:
    """Position on a path back and forth over a stroke, starting in its middle."""
    phase = math.fmod(path + stroke / 2.0, 2.0 * stroke)
    return (phase if phase <= stroke else 2.0 * stroke - phase) - stroke / 2.0


def tool_at(block: DayPart, time_s: float, program: LoadCase) -> int:
    if block.kind in (Activity.PAUSE, Activity.NIGHT):
        return 0
    return 1 + int(block.start_s / 300.0 + max(0.0, time_s - block.start_s) / program.operation_s) % 20


def probing_positions(settings: CycleSettings, since_s: float, raised_mm: float = 0.0) -> dict[str, float]:
    """Positions this long after the start of a cycle, or of a dry run that is raised by this height.

    Each pose is held from half of its slot until its touches are done; before, the tool goes up, the axes go to the
    pose where the sphere cannot reach it, and the tool goes down. After the last one they go back to the first, where
    the cycle ends.
    """
    slot = (settings.duration_s - 2 * settings.approach_s) / len(settings.poses_deg)
    progress = (since_s - settings.approach_s) / slot
    pose = min(max(math.floor(progress), 0), len(settings.poses_deg) - 1)
    part = min(max((progress - pose) * 2.0, 0.0), 1.0)
    before = max(pose - 1, 0)
    if (back_s := since_s - settings.duration_s + settings.approach_s) > 0:
        before, pose, part = pose, 0, min(2.0 * back_s / settings.approach_s, 1.0)
    start = (*settings.nominal_centre_mm(before), *settings.poses_deg[before])
    end = (*settings.nominal_centre_mm(pose), *settings.poses_deg[pose])
    across = min(max((part - 0.2) / 0.6, 0.0), 1.0)
    positions = {axis: s + across * (e - s) for axis, s, e in zip(AXIS_LETTERS, start, end, strict=True)}
    if start == end:
        return positions | {"Z": positions["Z"] + raised_mm}
    low, up = (start[2], part / 0.3) if part < 0.5 else (end[2], (1.0 - part) / 0.3)
    over = math.hypot(settings.radius_mm, settings.height_mm) + _OVER_MM
    return positions | {"Z": low + min(up, 1.0) * (over - low) + raised_mm}


def probing_loads(settings: CycleSettings) -> MeanLoads:
    """Mean speeds of the moves from pose to pose and back, spindle at rest, no cutting fluid."""
    points = [(*settings.nominal_centre_mm(pose), *settings.poses_deg[pose]) for pose in range(len(settings.poses_deg))]
    path = np.abs(np.diff([*points, points[0]], axis=0)).sum(axis=0) / (settings.duration_s / 60.0)
    x, y, z, a, c = (float(v) for v in path)
    return MeanLoads(x=x, y=y, z=z, a=a / 360.0, c=c / 360.0)
