"""Poses of a probing cycle, chosen so that what is left at the tool after it is least, within travel and time.

I-optimal: least mean variance of the tool's position over the work space; a greedy start, then exchange of single poses
(Fedorov). A set whose weakest coordinate shows less than FREE_SHARE of a wrong touch is worse in that proportion.

Examples
--------
A machine with its feedback at the slides, where one sphere tells all there is:

>>> from talc.chain import Machine, chain_of
>>> from talc.knowable import Artefacts, Travel, known_by
>>> from talc.poses import plan
>>> machine = Machine(chain_of("w C' A' X' b Y Z S t"), glass_scales=frozenset("XYZ"), radius_m=0.2)
>>> travel = Travel(machine, {"A": (-90, 90)}, ((-0.2, 0.2), (-0.2, 0.2), (0, 0.2)))
>>> sphere = Artefacts(((0.2, 0.0, 0.08),))
>>> known = known_by(travel, sphere)
>>> found = plan(travel, sphere, known, sigma_um=1.0, most_s=150.0, most=20)
>>> len(known.estimated), len(known.unseen), len(found.poses) > 6, bool(found.sigma.max() < 10)
(14, 0, True, True)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from talc.frame import FloatArray
from talc.knowable import Artefacts, Known, Pose, Travel

FREE_SHARE: Final = 0.2
"""Share of a wrong touch that its own residual shows; the rest goes into the errors."""
_GUESS: Final = 100.0
"""Standard deviation of a first guess of each error, µm and µm/m: sets that do not yet find them all are comparable."""
_SWEEPS: Final = 5
_WORTH: Final = 0.999
"""An exchange that improves a set by less is none."""
_DEGREES_PER_S, _M_PER_S, _CHANGE_S, _POSE_S = 60.0, 0.25, 20.0, 14.0
"""Assumed: speeds of the axes; the probe's change, there and back; approach, and five touches of 2 s."""


@dataclass(frozen=True)
class Plan:
    """Poses, and what a cycle of them tells."""

    poses: tuple[Pose, ...]
    seconds: float
    sigma: FloatArray
    """(p,) standard uncertainty of each estimated error, µm and µm/m; infinite: these poses do not find it."""
    tool_um: FloatArray
    """(n,) standard uncertainty of the tool's place at points over the work space, from the estimated errors."""
    free_share: float
    """Least share of a wrong coordinate that its residual shows."""


def plan(travel: Travel, artefacts: Artefacts, known: Known, *, sigma_um: float, most_s: float, most: int) -> Plan:
    """The best poses, `most` of them and `most_s` at most, in the order in which they are reached soonest.

    sigma_um: standard uncertainty of one coordinate of a centre, and of a known length. Raises ValueError: no pose can
    be touched in this time.
    """
    sets = _Sets(travel, artefacts, known, most_s)
    best: list[int] = []
    while len(best) < most and (found := sets.first(sets.scores(best, checked=False), best)) is not None:
        best.append(found)
    if not best:
        raise ValueError(f"no pose can be reached and touched within {most_s:g} s")
    least = np.inf
    for _ in range(_SWEEPS):
        before = least
        for _ in range(len(best)):
            old, *others = best
            scores = sets.scores(others, checked=True)
            new = sets.first(scores, others)
            best = [*others, old if new is None or scores[new] > scores[old] * _WORTH else new]
            least = min(least, float(scores[best[-1]]))
        if least > before * _WORTH:
            break
    return judged(travel, artefacts, known, [sets.tried[n] for n in _ordered(sets.takes, best)], sigma_um)


class _Sets:
    """Sets of the poses that are tried, as indices."""

    def __init__(self, travel: Travel, artefacts: Artefacts, known: Known, most_s: float) -> None:
        self.tried = artefacts.poses(travel)
        self.takes = _moves(travel, artefacts, self.tried)
        """(n, n) s from one to another."""
        self._blocks, given, tool = _equations(travel, artefacts, known, self.tried)
        self._weights = np.einsum("cki,ckj->cij", self._blocks, self._blocks)
        self._aim = np.einsum("nki,nkj->ij", tool, tool) / len(tool)
        self._base = given.T @ given + np.eye(len(self._aim)) / _GUESS**2
        self._most_s = most_s

    def scores(self, others: list[int], *, checked: bool) -> FloatArray:
        """(n,) of each pose beside the others, less is better. checked: whether wrong touches shall show."""
        covariance = np.linalg.inv(self._base + self._weights[others].sum(axis=0) + self._weights)
        left = np.asarray(np.einsum("cij,ji->c", covariance, self._aim))
        if not checked:
            return left
        hidden = np.einsum("cki,cij,ckj->ck", self._blocks, covariance, self._blocks).max(axis=1)
        if others:
            rows = self._blocks[others].reshape(-1, len(self._aim))
            hidden = np.maximum(hidden, np.einsum("ri,cij,rj->cr", rows, covariance, rows, optimize=True).max(axis=1))
        return np.asarray(left * np.maximum(1.0, FREE_SHARE / np.maximum(1.0 - hidden, FREE_SHARE / 10)))

    def first(self, scores: FloatArray, others: list[int]) -> int | None:
        """The best one that fits into the time; no pose twice before all are used once."""
        used = np.bincount(others, minlength=len(self.tried))
        for n in np.argsort(scores, kind="stable").tolist():
            if used[n] == used.min() and _seconds(self.takes, _ordered(self.takes, [*others, n])) <= self._most_s:
                return int(n)
        return None


def judged(travel: Travel, artefacts: Artefacts, known: Known, poses: Sequence[Pose], sigma_um: float) -> Plan:
    """What a cycle of given poses, in this order, tells of the estimated errors."""
    blocks, given, tool = _equations(travel, artefacts, known, poses)
    rows = np.vstack([blocks.reshape(-1, tool.shape[2]), given])
    _, values, directions = np.linalg.svd(rows, full_matrices=True)
    found = np.zeros(tool.shape[2], dtype=bool)
    found[: len(values)] = values > 1e-9 * values[0]
    loose = (directions[~found] ** 2).sum(axis=0) > 1e-6
    inverse = np.linalg.pinv(rows)
    reached = np.sqrt(np.einsum("nki,ij,nkj->n", tool, inverse @ inverse.T, tool)) * sigma_um
    takes = _moves(travel, artefacts, poses)
    return Plan(
        tuple(poses),
        _seconds(takes, range(len(poses))),
        np.where(loose, np.inf, np.linalg.norm(inverse, axis=1) * sigma_um),
        reached if found.all() else np.full(len(tool), np.inf),
        float(1.0 - np.einsum("ij,ji->i", rows, inverse)[: 3 * len(poses)].max()),
    )


@dataclass(frozen=True)
class Unmodelled:
    """What a cycle makes of an error that is not solved for."""

    error: str
    residual_um: float
    """RMS of what the solved errors do not explain."""
    before_um: float
    """Largest deviation of the tool in the work space that the error makes."""
    after_um: float
    """The same after the solved errors are compensated: they have taken part of it, or added to it."""


def unmodelled(
    travel: Travel, artefacts: Artefacts, solved: Known, poses: Sequence[Pose], size: float
) -> list[Unmodelled]:
    """For every other error of this size, µm or µm/m, that is none of the solved ones by another name."""
    machine, found = travel.machine, []
    blocks, given, tool = _equations(travel, artefacts, solved, poses)
    others = [name for name in machine.errors if name not in (*solved.estimated, *solved.alike)]
    other_blocks, other_given, other_tool = _equations(
        travel, artefacts, Known(tuple(others), (), (), frozenset()), poses
    )
    rows = np.vstack([blocks.reshape(-1, tool.shape[2]), given])
    seen = size * np.vstack([other_blocks.reshape(-1, len(others)), other_given])
    taken = np.linalg.pinv(rows) @ seen
    residual = np.sqrt(np.mean((seen - rows @ taken) ** 2, axis=0))
    for n, name in enumerate(others):
        before = size * other_tool[:, :, n]
        after = before - tool @ taken[:, n]
        found.append(Unmodelled(name, float(residual[n]), _largest(before), _largest(after)))
    return found


def expected(
    travel: Travel, artefacts: Artefacts, poses: Sequence[Pose], *, sigma_um: float, size: float
) -> tuple[float, float]:
    """What a cycle is worth on a machine whose errors all have this standard deviation, µm and µm/m: RMS of the tool's
    deviation over the work space, µm, before and after the best correction from the cycle (Gauss-Markov). What cannot
    be known is in both. ER0T counts as a scale: its size is per metre of the radius."""
    machine = travel.machine
    sizes = np.array([size * machine.radius_m if name == "ER0T" else size for name in machine.errors])
    blocks, given, tool = _equations(travel, artefacts, Known(machine.errors, (), (), frozenset()), poses)
    rows, at_tool = np.vstack([blocks.reshape(-1, len(sizes)), given]) * sizes, tool.reshape(-1, len(sizes)) * sizes
    seen = at_tool @ rows.T
    known = np.linalg.solve(rows @ rows.T + sigma_um**2 * np.eye(len(rows)), seen.T).T
    before = float(np.sum(at_tool**2))
    return math.sqrt(before / len(tool)), math.sqrt((before - float(np.sum(known * seen))) / len(tool))


def _largest(deviations: FloatArray) -> float:
    return float(np.linalg.norm(deviations, axis=1).max())


def _equations(
    travel: Travel, artefacts: Artefacts, known: Known, poses: Sequence[Pose]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 3, p) of the poses, (k, p) of known lengths, (points, 3, p) of the tool, for the estimated errors."""
    machine = travel.machine
    columns = [machine.errors.index(name) for name in known.estimated]
    rows = np.reshape([artefacts.rows(machine, pose) for pose in poses], (-1, 3, len(machine.errors)))
    return rows[:, :, columns], artefacts.known_lengths(machine)[:, columns], travel.tool[:, :, columns]


def _moves(travel: Travel, artefacts: Artefacts, poses: Sequence[Pose]) -> FloatArray:
    """(n, n) s from one pose to another."""
    angles = np.array([pose.angles_deg for pose in poses]).reshape(len(poses), -1)
    places = np.array(
        [travel.machine.linear(np.array(artefacts.spheres_m[p.sphere]), np.radians(p.angles_deg)) for p in poses]
    ).reshape(-1, 3)
    turned = np.abs(angles[:, None] - angles[None]).max(axis=2, initial=0.0) / _DEGREES_PER_S
    moved = np.linalg.norm(places[:, None] - places[None], axis=2) / _M_PER_S
    return np.asarray(np.maximum(turned, moved))


def _ordered(takes: FloatArray, chosen: Sequence[int]) -> list[int]:
    """From the first as it was tried, always on to the nearest."""
    left = sorted(chosen)
    order = [left.pop(0)]
    while left:
        order.append(left.pop(int(np.argmin(takes[order[-1], left]))))
    return order


def _seconds(takes: FloatArray, order: Sequence[int]) -> float:
    return _CHANGE_S + len(order) * _POSE_S + float(sum(takes[a, b] for a, b in pairwise(order)))
