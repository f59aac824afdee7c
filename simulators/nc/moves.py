"""Where the axes are, and which tool is in the spindle, while the emulated control's program runs."""

import math

from simulators.nc.program import Activity, DayPart, LoadCase

_CENTRE_MM = {"X": 0.0, "Y": 0.0, "Z": 150.0}
_STROKE_MM = {"X": 300.0, "Y": 300.0, "Z": 200.0}
_A_STROKE_DEG = 120.0


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
