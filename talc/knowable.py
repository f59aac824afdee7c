"""What touches of spheres can tell of a chain's errors, how well, and at which poses best.

Errors that look alike and act alike at every point of the work space are one: the first name is kept. What moves the
tool and no sphere is *unseen*: no number of touches finds it, and another artefact must.

Examples
--------
One sphere on a three-axis mill, 600 x 400 x 400 mm, tells where the spindle is, and nothing else:

>>> import numpy as np
>>> from talc.chain import Machine, chain_of
>>> from talc.knowable import Artefacts, Travel, known_by
>>> mill = Travel(Machine(chain_of("w X' Y' b Z S t")), {"X": (0, 0.6), "Y": (0, 0.4), "Z": (-0.4, 0)},
...               ((0, 0.6), (0, 0.4), (-0.4, 0)))
>>> known = known_by(mill, Artefacts(((0.3, 0.2, -0.3),)))
>>> known.estimated, len(known.unseen)
(('EX0S', 'EY0S', 'EZ0S'), 6)
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from talc.chain import LINEAR, Machine
from talc.frame import FloatArray

SHOWN_UM: Final = 10.0
"""An unseen direction is stated at the size at which it moves the tool by this at most, in the work space."""
STEEP: Final = 0.5
"""Cosine of the tilt of a table, 60 degrees, up to which the spindle is well above all of it."""
RING_M: Final = 0.1
"""Diameter of a ring gauge that is proposed."""
_NAMED_UM: Final = 0.1
"""What moves the tool by less in a direction of that size is not named."""
_DEPENDENT: Final = 1e-7
_TOOL_POINTS: Final = 300
_STEPS_DEG: Final = (15.0, 30.0)
"""Of the poses that are tried: of an axis that turns no more than 180 degrees, and of others."""

Range = tuple[float, float]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Travel:
    """A machine, how far its axes go, and where it works."""

    machine: Machine
    axes: Mapping[str, Range]
    """Least and largest position of each axis, metres and degrees; an axis that is not named has no limit, a rotary one
    turns from 0 to 360."""
    work_m: tuple[Range, Range, Range]
    """X, Y, Z of where the tool touches workpieces, in the coordinates of `Machine` with all axes at zero."""

    def reached(self, point_m: Point | FloatArray, angles_deg: Sequence[float]) -> bool:
        """Whether the tip gets to a point of the workpiece at these angles."""
        there = self.machine.linear(np.asarray(point_m), np.radians(angles_deg))
        limits = [self.axes.get(axis, (-math.inf, math.inf)) for axis in LINEAR]
        return all(low - 1e-9 <= at <= high + 1e-9 for at, (low, high) in zip(there, limits, strict=True))

    def free(self, point_m: Point, angles_deg: Sequence[float]) -> bool:
        """Whether a spindle over this point of the table is beside the table or well above it: beyond STEEP only over
        its upper half, where the spindle is further out than the point."""
        up, normal = self.machine.upwards(np.radians(angles_deg)), self.machine.normal
        out = self.machine.outwards(np.asarray(point_m))
        above = float(up @ normal)
        return above > STEEP or (above > -1e-9 and float(up @ out) > -1e-9)

    def turns(self) -> list[Range]:
        """Travel of the rotary axes in alphabetical order, degrees."""
        return [self.axes.get(axis, (0.0, 360.0)) for axis in self.machine.chain.rotary]

    @cached_property
    def tool(self) -> FloatArray:
        """(n, 3, m) Jacobian at points over the work space and all angles; ValueError if the axes reach none."""
        draw, turns = np.random.default_rng(0), self.turns()
        found: list[FloatArray] = []
        for _ in range(20 * _TOOL_POINTS):
            point = np.array([draw.uniform(*side) for side in self.work_m])
            angles = [draw.uniform(*turn) for turn in turns]
            if self.reached(point, angles):
                found.append(self.machine.jacobian(point, np.radians(angles)))
                if len(found) == _TOOL_POINTS:
                    break
        if not found:
            raise ValueError("the axes reach no point of the work space")
        return np.array(found)


@dataclass(frozen=True)
class Pose:
    """One place of the cycle."""

    angles_deg: tuple[float, ...]
    """Of the rotary axes, in alphabetical order."""
    sphere: int


@dataclass(frozen=True)
class Artefacts:
    """What stands on the table."""

    spheres_m: tuple[Point, ...]
    """Centres, with all axes at zero."""
    lengths_m: tuple[tuple[Point, str, float], ...] = ()
    """Known lengths, which do not grow with the table: middle, along which axis, how long. A ring gauge has two."""

    def poses(self, travel: Travel) -> list[Pose]:
        """All that are tried: a grid over the travel of the rotary axes, as far as the spindle is free of the table."""
        return [
            Pose(at, n)
            for n, centre in enumerate(self.spheres_m)
            for at in itertools.product(*map(_grid, travel.turns()))
            if travel.free(centre, at) and travel.reached(centre, at)
        ]

    def rows(self, machine: Machine, pose: Pose) -> FloatArray:
        """(3, m) movement of the sphere's centre at a pose per unit of each error."""
        return machine.jacobian(np.array(self.spheres_m[pose.sphere]), np.radians(pose.angles_deg))

    def known_lengths(self, machine: Machine) -> FloatArray:
        """(n, m) change of each known length as the machine measures it, with the rotary axes at zero."""
        rows, zero = [], np.zeros(len(machine.chain.rotary))
        growth = [machine.errors.index(name) for name in ("EZ0T", "ER0T")]
        for middle, along, length in self.lengths_m:
            half = length / 2 * np.eye(3)[LINEAR.index(along)]
            ends = (machine.jacobian(np.array(middle) + side * half, zero) for side in (1, -1))
            row = np.subtract(*ends)[LINEAR.index(along)]
            row[growth] = 0.0  # it stands on the table at one place
            rows.append(row)
        return np.reshape(rows, (-1, len(machine.errors)))


@dataclass(frozen=True)
class Known:
    """What artefacts can tell."""

    estimated: tuple[str, ...]
    """Errors that touches find, if the unseen ones are left out."""
    alike: tuple[str, ...]
    """Errors that look and act as estimated ones do, everywhere: they are in those."""
    unseen: tuple[Mapping[str, float], ...]
    """Each: errors in µm and µm/m that together move the tool by SHOWN_UM at most, and nothing that is touched."""
    combined: frozenset[str]
    """Estimated errors that are part of an unseen direction: known only while it is zero."""


def known_by(travel: Travel, artefacts: Artefacts) -> Known:
    """What the artefacts tell if they are touched at every pose. Raises ValueError as `Travel.tool`, and if a sphere is
    reached at none."""
    machine, tool = travel.machine, travel.tool.reshape(-1, len(travel.machine.errors))
    poses = artefacts.poses(travel)
    if missed := set(range(len(artefacts.spheres_m))) - {pose.sphere for pose in poses}:
        places = "; ".join(" ".join(f"{at * 1e3:.0f}" for at in artefacts.spheres_m[n]) for n in sorted(missed))
        raise ValueError(f"the axes reach no pose over the sphere at {places} mm")
    design = np.vstack([*(artefacts.rows(machine, pose) for pose in poses), artefacts.known_lengths(machine)])
    apart = _independent(np.vstack([design, tool]), range(len(machine.errors)))
    found = _independent(design, apart)
    unseen, combined = [], set()
    for n in (n for n in apart if n not in found):
        direction = np.zeros(len(machine.errors))
        direction[n] = 1.0
        direction[found] = -np.linalg.lstsq(design[:, found], design[:, n], rcond=None)[0]
        direction *= SHOWN_UM / np.linalg.norm((tool @ direction).reshape(-1, 3), axis=1).max()
        size = np.linalg.norm((tool * direction).reshape(-1, 3, len(direction)), axis=1).max(axis=0)
        order = np.argsort(-np.round(size, 6), kind="stable")
        parts = {machine.errors[k]: float(direction[k]) for k in order if size[k] > _NAMED_UM}
        unseen.append(parts)
        combined |= set(parts)
    names = tuple(machine.errors[n] for n in found)
    return Known(
        names,
        tuple(name for n, name in enumerate(machine.errors) if n not in apart),
        tuple(unseen),
        frozenset(combined & set(names)),
    )


def _grid(turn: Range) -> list[float]:
    """Round angles within a travel, and its ends; once around is where it began."""
    low, high = turn
    step = _STEPS_DEG[high - low > 180]
    between = (step * n for n in range(math.floor(low / step) + 1, math.ceil(high / step)))
    return [angle for angle in (low, *between, high) if angle < low + 360]


def _independent(matrix: FloatArray, columns: Sequence[int]) -> list[int]:
    """Those of the columns that are no combination of earlier ones."""
    kept: list[int] = []
    basis: list[FloatArray] = []
    for n in columns:
        column = matrix[:, n] / max(float(np.linalg.norm(matrix[:, n])), 1e-300)
        for _ in range(2):  # once more for what rounding left
            for direction in basis:
                column = column - (direction @ column) * direction
        if (left := float(np.linalg.norm(column))) > _DEPENDENT:
            basis.append(column / left)
            kept.append(n)
    return kept


def with_ring(travel: Travel, artefacts: Artefacts, diameter_m: float) -> Artefacts:
    """The same and a ring gauge of known diameter, on the floor of the middle of the work space."""
    (left, right), (front, back), (floor, _) = travel.work_m
    middle = (left + right) / 2, (front + back) / 2, floor
    return replace(artefacts, lengths_m=tuple((middle, axis, diameter_m) for axis in "XY"))


def with_spheres(travel: Travel, artefacts: Artefacts, count: int) -> Artefacts:
    """The same with so many spheres: the further ones at corners of the work space that the tip reaches at some pose,
    as far from each other, and from one plane, as they can be."""
    corners = [corner for corner in itertools.product(*travel.work_m) if Artefacts((corner,)).poses(travel)]
    more = max(count - len(artefacts.spheres_m), 0)

    def spread(added: tuple[Point, ...]) -> float:
        places = np.array([*artefacts.spheres_m, *added])
        return float(np.prod(np.linalg.svd(places[1:] - places[0], compute_uv=False)))

    chosen = max(itertools.combinations(corners, min(more, len(corners))), key=spread) if more else ()
    return replace(artefacts, spheres_m=artefacts.spheres_m + chosen)


def cheapest(travel: Travel, artefacts: Artefacts) -> tuple[Artefacts, Known]:
    """What to add so that least stays unseen, the cheapest first: a ring gauge, a second sphere, both, four spheres,
    four spheres and a ring gauge. Raises ValueError as `Travel.tool`."""
    two, four = (with_spheres(travel, artefacts, count) for count in (2, 4))
    ring = artefacts if artefacts.lengths_m else with_ring(travel, artefacts, RING_M)
    both, all_five = (replace(spheres, lengths_m=ring.lengths_m) for spheres in (two, four))
    best = artefacts, known_by(travel, artefacts)
    for each in (ring, two, both, four, all_five):
        if best[1].unseen and len((known := known_by(travel, each)).unseen) < len(best[1].unseen):
            best = each, known
    return best
