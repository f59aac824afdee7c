"""The probing cycle's path: the places of the spindle at all poses, and whether the machine's travel contains them.

The same geometry as talc_over.ngc and talc_touch.ngc. Lengths in mm, angles in degrees.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from talc_joints import AXES, MachineJoints
from talc_reasons import NONE, Reason

POSES = 6
POSE_FIELDS = tuple(f"POSE_{pose}_{axis}" for pose in range(POSES) for axis in "AC")
FIELDS = (
    *(
        "SPHERE_HEIGHT",
        "BALL",
        "SAFE_Z",
        "CLEAR",
        "REACH",
        "FINE_REACH",
        "FIND_FEED",
        "FEED",
        "APPROACH_FEED",
        "DRY_FEED",
    ),
    *POSE_FIELDS,
)
"""What the programs need of [TALC]: without one of them LinuxCNC would end the part program."""
_POSITIVE = ("BALL", "CLEAR", "REACH", "FINE_REACH", "FIND_FEED", "FEED", "APPROACH_FEED", "DRY_FEED")
NUMBER = {axis: "XYZABCUVW".index(axis) for axis in AXES}
"""Of the axes in LinuxCNC's lists."""

_AT_MM = 0.01
"""What is no farther from a place is there."""
Range = tuple[float, float]


class ProbingPath:
    """The path on one machine.

    unfit: why the programs cannot run on it at all; empty: they can. poses: A and C of each. probe_tool: the number of
    the touch probe.
    """

    def __init__(self, machine: MachineJoints) -> None:
        self._machine = machine
        self.probe_tool = round(machine.number("PROBE_TOOL", 99))
        self._of = {name: machine.number(name, math.nan) for name in FIELDS}
        self.poses = [(self._of[f"POSE_{i}_A"], self._of[f"POSE_{i}_C"]) for i in range(POSES)]
        self.unfit = self._why_unfit()

    def _why_unfit(self) -> Reason:
        machine = self._machine
        if machine.mm != 1.0:
            return Reason("units", f"[TRAJ] LINEAR_UNITS = {machine.unit}: the probing program works in mm only")
        if machine.takes_back:
            return Reason("abort_command", machine.takes_back)
        for name, value in self._of.items():
            if not math.isfinite(value):
                return Reason("setting", f"[TALC] {name} is missing: the probing program needs it")
            if name in _POSITIVE and not value > 0:
                return Reason("setting", f"[TALC] {name} = {value:g}: expected more than 0")
        swing, safe = math.hypot(machine.radius, self._of["SPHERE_HEIGHT"]) + self._of["BALL"], self._of["SAFE_Z"]
        if safe > swing:
            return NONE
        return Reason("safe_height", f"[TALC] SAFE_Z = {safe:g}: the sphere swings up to {swing:.1f} mm over the pivot")

    @property
    def mark(self) -> str:
        """The same for the same [TALC] alone, as far as the path is made of it; 16 hexadecimal digits."""
        machine = self._machine
        made_of = {**self._of, "PIVOT": machine.pivot, "SPHERE_RADIUS": machine.radius, "PROBE_TOOL": self.probe_tool}
        return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:16]

    def obstacle(self, nc: Any, dry_run_mm: float) -> Reason:
        """Why the whole path cannot be gone in this state of the control; empty: it can. nc: a fresh linuxcnc.stat."""
        if self.unfit:
            return self.unfit
        probe = next((tool for tool in nc.tool_table if tool.id == self.probe_tool), None)
        if probe is None:  # LinuxCNC would end the part program that wants to change it in
            return Reason("no_probe", "the touch probe is not in the tool table")
        if probe.zoffset == 0:
            text = f"the length of the touch probe is not known: tool {self.probe_tool} has Z0 in the tool table"
            return Reason("probe_length", text)
        tool = {axis: getattr(probe, f"{axis.lower()}offset") for axis in AXES}
        c = nc.joint_actual_position[self._machine.joints["C"][0]] - tool["C"]
        limits = limits_of(nc, self._machine)
        why = (self.beyond(tool, limits, turns_deg, dry_run_mm) for turns_deg in full_turns_deg(c))
        return next(filter(None, why), NONE)

    def is_low(self, nc: Any) -> bool:
        """Whether the touch probe is in the spindle and its tip below SAFE_Z. nc: a fresh linuxcnc.stat."""
        if nc.tool_in_spindle != self.probe_tool:
            return False
        probe = next((tool for tool in nc.tool_table if tool.id == self.probe_tool), None)
        z = nc.joint_actual_position[self._machine.joints["Z"][0]] - self._machine.pivot[2]
        return bool(z - (probe.zoffset if probe is not None else 0.0) < self._of["SAFE_Z"] - _AT_MM)

    def least_dry_run_mm(self) -> float:
        """At this height the ways to the sphere's sides end just over it."""
        return self._of["BALL"] + 2.0 * self._of["REACH"]

    def beyond(
        self, tool: Mapping[str, float], limits: Mapping[str, Range], turns_deg: float = 0.0, dry_run_mm: float = 0.0
    ) -> Reason:
        """What of the path is beyond the limits; empty: nothing.

        tool: the probe's offsets, by axis. limits: of each axis. turns_deg: where C counts from.
        """
        zero = {**dict(zip("XYZ", self._machine.pivot, strict=True)), "A": 0.0, "C": turns_deg}
        for pose, ranges in enumerate(self._ranges(dry_run_mm), start=1):
            for axis, (least, most) in ranges.items():
                low, high = limits[axis]
                needed = least + zero[axis] + tool[axis], most + zero[axis] + tool[axis]
                if low <= needed[0] and needed[1] <= high:
                    continue
                at, limit = (needed[0], low) if needed[0] < low else (needed[1], high)
                return Reason(
                    "beyond_travel",
                    f"pose {pose} needs {axis} = {at:.1f} with the probe in the spindle, beyond the limit {limit:g}: "
                    f"see [TALC] SAFE_Z, sphere, pivot and poses, the tool table and [AXIS_{axis}]",
                )
        return NONE

    def _ranges(self, dry_run_mm: float) -> Iterator[dict[str, Range]]:
        """Of the tip from where A and C meet, with the sphere as far off its place as a touch may find it."""
        radius, height, reach = self._machine.radius, self._of["SPHERE_HEIGHT"], self._of["REACH"]
        aside = self._of["BALL"] + 2.0 * reach
        for a, c in self.poses:
            ca, sa, cc, sc = (f(math.radians(v)) for v in (a, c) for f in (math.cos, math.sin))
            x, y = radius * cc, radius * sc * ca - height * sa
            z = radius * sc * sa + height * ca + dry_run_mm
            top = max(self._of["SAFE_Z"], z + self._of["BALL"] + self._of["CLEAR"] + reach)
            yield {
                "X": (x - aside, x + aside),
                "Y": (y - aside, y + aside),
                "Z": (z - reach, top),
                "A": (a, a),
                "C": (c, c),
            }


def full_turns_deg(c_deg: float) -> list[float]:
    """Where talc_begin.ngc may let C count from: the nearest full turn; half way between two of them, both."""
    turns = c_deg / 360.0
    return sorted({360.0 * math.floor(turns + 0.5 + margin) for margin in (-1e-6, 1e-6)})


def limits_of(nc: Any, machine: MachineJoints) -> dict[str, Range]:
    """Of each axis, and of the joints that move it: the tighter ones. nc: a fresh linuxcnc.stat."""
    found = {}
    for axis in AXES:
        both = [nc.axis[NUMBER[axis]], *(nc.joint[n] for n in machine.joints[axis])]
        found[axis] = max(b["min_position_limit"] for b in both), min(b["max_position_limit"] for b in both)
    return found
