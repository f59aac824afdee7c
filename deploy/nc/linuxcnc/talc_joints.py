#!/usr/bin/python3
"""Units and joints of the machine, from LinuxCNC's INI file: which joints move which axis, in which unit.

As a program, for talc.tcl and drives.tcl: prints one line a joint, the name of its signals, its axis and its number;
with the argument `values` the component's parameters. A machine that the compensation does not understand ends it with
a message, and LinuxCNC does not start.
"""

import math
import os
import re
import sys
from collections.abc import Callable

MM = {"mm": 1.0, "metric": 1.0, "in": 25.4, "inch": 25.4, "imperial": 25.4}
"""mm in one of LinuxCNC's linear units."""
DEGREES = ("deg", "degree")
KINEMATICS = {"trivkins": "XYZABCUVW", "xyzac-trt-kins": "XYZAC"}
"""Kinematics in which every joint moves one axis of the machine, and the axes of their joints if not configured."""
AXES = "XYZAC"
TOOL_CENTRE_POINT = "xyzac-trt-kins"
SAME_MM = 1e-6
"""Lengths that differ by less are equal: they come from texts."""
MOST_MM = 0.5
"""Beyond this a bound is a mistake of units and not the growth of a machine."""

Find = Callable[[str, str], str | None]
"""The text of a field of a section, as linuxcnc.ini's find."""


class Unfit(Exception):
    """The message names file, field and value, and says what to do."""


class MachineJoints:
    """What the INI file says. Raises Unfit.

    find: reads the file. where: its name, for messages.
    """

    def __init__(self, find: Find, where: str) -> None:
        self._find, self._where = find, where
        self.kinematics = (self._text("KINS", "KINEMATICS").split() or [""])[0]
        self.unit = self._text("TRAJ", "LINEAR_UNITS").lower()
        if self.unit not in MM:
            raise self._unfit("TRAJ", "LINEAR_UNITS", "write mm or inch")
        self.mm = MM[self.unit]
        if (self._text("TRAJ", "ANGULAR_UNITS") or "deg").lower() not in DEGREES:
            raise self._unfit("TRAJ", "ANGULAR_UNITS", "write deg: the agent reads A and C in degrees")
        self.letters = self._letters()
        self.joints = {axis: tuple(n for n, letter in enumerate(self.letters) if letter == axis) for axis in AXES}
        self._check_joints()
        self.lower, self.bound, self.slew = self._length("LOWER", -0.2), self._length("BOUND", 0.2), self._slew()
        if not self.lower < 0 < self.bound:
            raise Unfit(f"{where}, [TALC] LOWER = {self.lower:g}, BOUND = {self.bound:g}: expected LOWER < 0 < BOUND")
        self.pivot = tuple(self.number(f"PIVOT_{axis}", 0.0) for axis in "XYZ")
        """Machine coordinates of the spindle's gauge point at the crossing of A and C, mm, as the probing program's."""
        self.radius = self.number("SPHERE_RADIUS", 120.0)
        """Of the sphere on the table, mm: where ER0T is measured."""
        if not 0 < self.radius < math.inf:
            raise self._unfit("TALC", "SPHERE_RADIUS", "expected more than 0, in mm")
        x, y, z = (self._reach(axis, zero) for axis, zero in zip("XYZ", self.pivot, strict=True))
        self.reach = x, math.hypot(y, z)
        """Farthest point of the travel from where A and C meet: along X, and across it; mm."""

    @property
    def bound_um(self) -> float:
        """The largest offset either way, µm."""
        return min(self.bound, -self.lower) * self.mm * 1e3

    def elsewhere(self, pin: Callable[[str], float]) -> str:
        """Why the kinematics turn the table about other axes than the compensation does; empty: about the same ones.

        pin: the value of one of LinuxCNC's pins. The kinematics' lengths are pins, which a HAL file sets at any time;
        while all are 0, nobody has set them up, and the machine works with identity kinematics alone.
        """
        if self.kinematics != TOOL_CENTRE_POINT:
            return ""
        names = "x-rot-point", "y-rot-point", "z-rot-point", "y-offset", "z-offset"
        x, y, z, apart, above = (pin(f"{TOOL_CENTRE_POINT}.{name}") * self.mm for name in names)
        if not any((x, y, z, apart, above)):
            return ""
        if abs(apart) > SAME_MM:
            return (
                f"{TOOL_CENTRE_POINT}.y-offset = {apart / self.mm:g}: expected 0, because the compensation supports "
                "only machines whose axes A and C meet"
            )
        for axis, theirs, ours in zip("xyz", (x, y, z + above), self.pivot, strict=True):
            if abs(theirs - ours) > SAME_MM:
                name = f"{TOOL_CENTRE_POINT}.{axis}-rot-point"
                name += f" + {TOOL_CENTRE_POINT}.z-offset" if axis == "z" else ""
                return (
                    f"{self._where}, [TALC] PIVOT_{axis.upper()} = {ours:g} mm, but {name} = {theirs:g} mm: both say "
                    "where A and C meet, so make them equal"
                )
        return ""

    def values(self) -> dict[str, float]:
        """The parameters of the component talc-errors."""
        return {
            "bound-um": self.bound_um,
            "slew-um-per-s": self.slew * self.mm * 1e3,
            "unit-mm": self.mm,
            **{f"pivot-{axis}": zero for axis, zero in zip("xyz", self.pivot, strict=True)},
            "sphere-radius": self.radius,
            "reach-x": self.reach[0],
            "reach-yz": self.reach[1],
        }

    def named(self) -> list[tuple[str, str, int]]:
        """Name of the joint's signals, axis, number: x for the first joint of X, x2 for the second of a gantry."""
        rows = []
        for axis, joints in self.joints.items():
            rows += [(f"{axis.lower()}{i or ''}", axis, n) for i, n in zip((0, 2, 3, 4, 5, 6), joints, strict=False)]
        return rows

    def number(self, name: str, default: float) -> float:
        """A number of the section [TALC]."""
        text = self._text("TALC", name) or str(default)
        try:
            return float(text)
        except ValueError:
            raise self._unfit("TALC", name, "expected a number") from None

    def text(self, name: str, default: str) -> str:
        """A text of the section [TALC]."""
        return self._text("TALC", name) or default

    @property
    def takes_back(self) -> str:
        """Why LinuxCNC does not call talc_abort when it stops a program; empty: it does."""
        section, name = "RS274NGC", "ON_ABORT_COMMAND"
        if re.fullmatch(r"o<talc_abort>call", re.sub(r"\s", "", self._text(section, name)), re.IGNORECASE):
            return ""
        what = "write O <talc_abort> call, or a stopped cycle leaves its own modes and coordinates in force"
        return str(self._unfit(section, name, f"{what}; what your own command does goes into talc_abort.ngc"))

    def _letters(self) -> str:
        """The axis of each joint, in the order of the joints."""
        kinematics, parameters = self.kinematics, self._text("KINS", "KINEMATICS").split()[1:]
        if kinematics not in KINEMATICS:
            known = " or ".join(KINEMATICS)
            raise self._unfit("KINS", "KINEMATICS", f"the compensation supports {known}, where a joint moves an axis")
        given = next((p.partition("=")[2] for p in parameters if p.lower().startswith("coordinates=")), "")
        declared = re.sub(r"[\s,]", "", self._text("TRAJ", "COORDINATES")).upper()
        count = self._text("KINS", "JOINTS")
        letters = (given or KINEMATICS[kinematics][: int(count) if count.isdecimal() else None]).upper()
        if set(declared) != set(AXES):
            raise self._unfit("TRAJ", "COORDINATES", f"the compensation supports machines with the axes {AXES}")
        if letters != declared:
            raise self._unfit(
                "KINS",
                "KINEMATICS",
                f"its joints are {letters}, but [TRAJ] COORDINATES = {declared}: add coordinates={declared} to it",
            )
        if count != str(len(letters)):
            raise self._unfit("KINS", "JOINTS", f"expected {len(letters)}, one for each letter of {letters}")
        return letters

    def _check_joints(self) -> None:
        for n, axis in enumerate(self.letters):
            section = f"JOINT_{n}"
            expected = "ANGULAR" if axis in "AC" else "LINEAR"
            if (self._text(section, "TYPE") or "LINEAR").upper() != expected:
                raise self._unfit(section, "TYPE", f"joint {n} moves {axis}: expected {expected}")
            if self._text(section, "UNITS"):
                raise self._unfit(section, "UNITS", "remove it: joints are in the units of [TRAJ]")

    def _reach(self, axis: str, zero: float) -> float:
        """The reach of any tool's tip, mm."""
        section, tool = f"AXIS_{axis}", self.number("LONGEST_TOOL", 200.0) if axis == "Z" else 0.0
        ends = []
        for name in ("MIN_LIMIT", "MAX_LIMIT"):
            try:
                ends.append(float(self._text(section, name)) * self.mm - zero)
            except ValueError:
                raise self._unfit(section, name, "expected the end of the travel") from None
        return max(abs(ends[0] - tool), abs(ends[0]), abs(ends[1]), abs(ends[1] - tool))

    def _length(self, name: str, default_mm: float) -> float:
        value = self.number(name, default_mm / self.mm)
        if not abs(value) * self.mm <= MOST_MM:
            most = f"{MOST_MM / self.mm:.3g} {self.unit}"
            raise self._unfit("TALC", name, f"{value * self.mm * 1e3:g} µm; expected at most {most}, in LINEAR_UNITS")
        return value

    def _slew(self) -> float:
        value = self.number("SLEW", 0.01 / self.mm)
        if not 0 < value < math.inf:
            raise self._unfit("TALC", "SLEW", f"expected more than 0, in {self.unit}/s")
        return value

    def _text(self, section: str, name: str) -> str:
        return (self._find(section, name) or "").strip()

    def _unfit(self, section: str, name: str, what: str) -> Unfit:
        return Unfit(f"{self._where}, [{section}] {name} = {self._text(section, name)}: {what}")


def machine_of(path: str) -> MachineJoints:
    """The machine of an INI file. Raises Unfit."""
    import linuxcnc

    return MachineJoints(linuxcnc.ini(path).find, path)


if __name__ == "__main__":
    try:
        machine = machine_of(os.environ["INI_FILE_NAME"])
        for row in machine.values().items() if sys.argv[1:] == ["values"] else machine.named():
            print(*row)
    except Unfit as unfit:
        sys.exit(f"talc: {unfit}")
