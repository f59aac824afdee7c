"""Any chain of axes in the notation of ISO 10791-1, and what each of its errors does where the tool touches.

A chain is two lists of axes from the bed outwards. At a position, each joint has a frame (R, o); p is the point
touched, and p' = R^-1 (p - o) in that frame. In the directions of the machine the errors move workpiece minus tool by

    D = sum over the workpiece's joints of R u(p')  -  sum over the tool's joints of R u(p')

    position and orientation of a rotary axis (ISO 230-7)     e,  e x p'           in the frame before its motion
    scale of a linear axis (EXX)                              (q - q0) e_k         the tool relative to the workpiece
    squareness of the linear axes (EC0Y, EB0Z, EA0Z)          (q - q0) e x e_k     the same
    growth of the table (EZ0T, ER0T)                          a,  (p' - a a.p')/R  a: the table's axis
    position and tilt of the spindle (EX0S, EA0S)             e,  e x (tip - gauge line)

D is what a touch probe reads more, and the shift of the tool that cancels it. The nine errors of `talc.names` are the
first nine of V[w - C' - A' - X' - b - Y - Z - S - t]; all are small, so what is left is of second order.

Examples
--------
A machine with a table that turns and a head that tilts; its B axis is 250 mm above the tip of the probe:

>>> import numpy as np
>>> from talc.chain import Machine, chain_of
>>> machine = Machine(chain_of("w C' Y' b X Z B S t"), origins_m={"B": (0.0, 0.0, 0.25)})
>>> machine.chain.rotary, machine.errors[:3]
(('B', 'C'), ('EX0C', 'EY0C', 'EX0B'))
>>> tilted = machine.jacobian(np.array([0.1, 0.0, 0.05]), np.array([np.pi / 2, 0.0]))[:, machine.errors.index("EZ0S")]
>>> [round(float(um), 3) + 0.0 for um in tilted]  # a spindle that grows downwards by -1 µm
[-1.0, 0.0, 0.0]
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from talc.frame import FloatArray
from talc.names import MICROMETRE, MICROMETRE_PER_METRE

LINEAR: Final = "XYZ"
ROTARY: Final = "ABC"
_AXES: Final = np.eye(3)
_ORIGIN: Final = (0.0, 0.0, 0.0)
_SQUARENESS: Final = (("EC0Y", 2, 1), ("EB0Z", 1, 2), ("EA0Z", 0, 2))
"""Name, about which axis, of which axis: Y and Z are square to X, and Z to Y."""


@dataclass(frozen=True, slots=True)
class Chain:
    """The order of a machine's axes."""

    workpiece: str
    """Axes from the bed to the workpiece."""
    tool: str
    """Axes from the bed to the spindle."""

    @property
    def rotary(self) -> tuple[str, ...]:
        """The rotary axes in alphabetical order: that of angles everywhere."""
        return tuple(sorted(set(self.workpiece + self.tool) & set(ROTARY)))

    @property
    def table(self) -> str:
        """The axis that turns the workpiece; of two the outer one. Empty: none does."""
        return next((axis for axis in reversed(self.workpiece) if axis in ROTARY), "")

    def __str__(self) -> str:
        return "-".join(("w", *(f"{axis}'" for axis in reversed(self.workpiece)), "b", *self.tool, "S", "t"))


def chain_of(text: str) -> Chain:
    """From `w C' A' X' b Y Z S t`, also with hyphens. Raises ValueError: another form, or a chain that is not covered.

    X, Y and Z occur once, rotary axes at most two times; linear axes are nearer to the bed than rotary ones.
    """
    words = [word for word in re.split(r"[\s-]+", text.strip()) if word]
    if words[:1] != ["w"] or words[-2:] != ["S", "t"] or words.count("b") != 1:
        raise ValueError(f"{text!r}: expected w, axes with ', b, axes, S, t, such as w C' A' X' b Y Z S t")
    bed = words.index("b")
    primed, tool = words[1:bed], words[bed + 1 : -2]
    if wrong := [word for word in primed if not re.fullmatch("[XYZABC]'", word)]:
        raise ValueError(f"{text!r}: {wrong[0]} between w and b: expected an axis with ', such as C'")
    if wrong := [word for word in tool if not re.fullmatch("[XYZABC]", word)]:
        raise ValueError(f"{text!r}: {wrong[0]} between b and S: expected X, Y, Z, A, B or C")
    workpiece = [word[0] for word in reversed(primed)]
    axes = workpiece + tool
    if sorted(axis for axis in axes if axis in LINEAR) != list(LINEAR) or len(set(axes)) < len(axes) or len(axes) > 5:
        raise ValueError(f"{text!r}: expected X, Y and Z once, and at most two different rotary axes")
    for side in (workpiece, tool):
        if [axis in ROTARY for axis in side] != sorted(axis in ROTARY for axis in side):
            raise ValueError(f"{text!r}: a linear axis on a rotary one is not covered")
    return Chain("".join(workpiece), "".join(tool))


@dataclass(frozen=True)
class Machine:
    """A chain with its sizes. Coordinates are the probe's tip's in metres: with all axes at zero it is at zero."""

    chain: Chain
    origins_m: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """A point of each rotary axis, with all axes at zero; one that is not named goes through the origin."""
    senses: Mapping[str, int] = field(default_factory=dict)
    """-1: a positive angle turns table or head against the right-hand rule."""
    fixed_m: Mapping[str, float] = field(default_factory=dict)
    """Position of a linear axis at which its scale error moves nothing: the fixed end of its screw or scale."""
    glass_scales: frozenset[str] = frozenset()
    """Linear axes measured at the slide, and not at the screw: they have no scale error."""
    probe_m: float = 0.15
    """From the spindle's gauge line to the tip of the probe."""
    radius_m: float = 0.12
    """At which ER0T is measured."""

    @property
    def errors(self) -> tuple[str, ...]:
        """The errors' names as ISO 230-1 and ISO 230-7 have them, the first ones first where two are the same.

        Those of V[w - C' - A' - X' - b - Y - Z - S - t] begin with the nine of talc.names."""
        rotary = [axis for axis in self.chain.workpiece + self.chain.tool if axis in ROTARY]
        positions = [f"E{at}0{axis}" for axis in rotary for at in LINEAR if LINEAR.index(at) != ROTARY.index(axis)]
        orientations = [f"E{about}0{axis}" for axis in reversed(rotary) for about in ROTARY]
        spindle, growth = [f"E{at}0S" for at in LINEAR], ["EZ0T", "ER0T"]
        scales = [f"E{axis}{axis}" for axis in LINEAR if axis not in self.glass_scales]
        linear = scales + [name for name, _, _ in _SQUARENESS]
        turns = bool(self.chain.table)  # else it only seems to be the spindle, and the scale of X and Y
        names = [*positions, *(growth if turns else ()), *orientations, *spindle, *linear, *(() if turns else growth)]
        return (*names, "EA0S", "EB0S")

    def linear(self, point_m: FloatArray, angles_rad: FloatArray) -> FloatArray:
        """(3,) X, Y, Z in metres with the tip at a point (3,) of the workpiece, given with all axes at zero."""
        touched = self._side(self.chain.workpiece, point_m, angles_rad)[2]
        return np.asarray(touched - self._side(self.chain.tool, _ORIGIN, angles_rad)[2])

    @property
    def normal(self) -> FloatArray:
        """(3,) axis of the table: Z, if it does not turn."""
        return np.asarray(_AXES[ROTARY.index(self.chain.table or "C")])

    def upwards(self, angles_rad: FloatArray) -> FloatArray:
        """(3,) from the tip to the spindle, in the directions of the workpiece."""
        spindle = self._side(self.chain.tool, _ORIGIN, angles_rad)[1][:, 2]
        return np.asarray(self._side(self.chain.workpiece, _ORIGIN, angles_rad)[1].T @ spindle)

    def outwards(self, point_m: FloatArray) -> FloatArray:
        """(3,) from the table's axis to a point, metres."""
        out = np.asarray(point_m) - np.array(self.origins_m.get(self.chain.table, _ORIGIN))
        return np.asarray(out - self.normal * (self.normal @ out))

    def jacobian(self, point_m: FloatArray, angles_rad: FloatArray) -> FloatArray:
        """(3, m) D in µm per unit of each of `errors` with the tip at a point (3,) of the workpiece.

        angles_rad: of the rotary axes, in alphabetical order. Raises ValueError for another number of them.
        """
        if np.shape(point_m) != (3,) or np.shape(angles_rad) != (len(self.chain.rotary),):
            raise ValueError(
                f"point_m {np.shape(point_m)}, angles_rad {np.shape(angles_rad)}: expected (3,) and one angle for each "
                f"of {self.chain.rotary}"
            )
        of: dict[str, FloatArray] = {}
        ends = []
        for axes, place, sign in ((self.chain.workpiece, point_m, 1.0), (self.chain.tool, _ORIGIN, -1.0)):
            frames, rotation, end = self._side(axes, place, angles_rad)
            ends.append((rotation, end))
            for axis, (before, origin) in frames.items():
                turned = sign * before @ _crossed(before.T @ (end - origin))
                for k in range(3):
                    of[f"E{LINEAR[k]}0{axis}"] = sign * before[:, k]
                    of[f"E{ROTARY[k]}0{axis}"] = turned[:, k]
        (table, touched), (spindle, tip) = ends
        moved = touched - tip - np.array([self.fixed_m.get(axis, 0.0) for axis in LINEAR])
        tilted = -spindle @ _crossed(np.array([0.0, 0.0, -self.probe_m]))
        for k in range(3):
            of[f"E{LINEAR[k]}{LINEAR[k]}"] = -moved[k] * _AXES[k]
            of[f"E{LINEAR[k]}0S"] = -spindle[:, k]
            of[f"E{ROTARY[k]}0S"] = tilted[:, k]
        for name, about, k in _SQUARENESS:
            of[name] = -moved[k] * _crossed(_AXES[k])[:, about]
        of["EZ0T"] = table @ self.normal
        of["ER0T"] = table @ self.outwards(point_m) / self.radius_m
        return np.column_stack([of[name] for name in self.errors])

    def _side(
        self, axes: str, place: FloatArray | tuple[float, ...], angles_rad: FloatArray
    ) -> tuple[dict[str, tuple[FloatArray, FloatArray]], FloatArray, FloatArray]:
        """Rotation and origin of each rotary axis before its motion, the rotation after all, and where `place` is then;
        the linear axes, which are nearer to the bed, at zero."""
        rotation, shift, frames = np.eye(3), np.zeros(3), {}
        for axis in (axis for axis in axes if axis in ROTARY):
            zero = np.array(self.origins_m.get(axis, _ORIGIN))
            origin = rotation @ zero + shift
            frames[axis] = rotation, origin
            angle = float(angles_rad[self.chain.rotary.index(axis)]) * self.senses.get(axis, 1)
            rotation = rotation @ _turned(ROTARY.index(axis), angle)
            shift = origin - rotation @ zero
        return frames, rotation, rotation @ np.asarray(place) + shift


def unit_of(error: str) -> str:
    """µm for positions and growth, µm/m for angles and scales."""
    return MICROMETRE if error[2] == "0" and error[1] in "XYZR" else MICROMETRE_PER_METRE


def _crossed(at: FloatArray) -> FloatArray:
    """(3, 3) column k: e_k x at."""
    x, y, z = at
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def _turned(axis: int, angle: float) -> FloatArray:
    """(3, 3) rotation about an axis by `angle` radians."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[j, j] = turn[k, k] = math.cos(angle)
    turn[k, j] = math.sin(angle)
    turn[j, k] = -turn[k, j]
    return turn
