"""The greeting of an agent: its version, capabilities and machine. See docs/agent.md, Greeting."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from drivers.agent.connection import Json
from drivers.agent.numbers import finite_number, finite_numbers, json_object, triple
from drivers.base import BadAnswer, WrongDevice
from drivers.nc import LINEAR_AXES, Triple
from drivers.text import Text

PROTOCOL_VERSION: Final = 3
"""The newest version of the protocol that this driver speaks; it speaks every earlier one."""
_SAME_DEG = 1e-3
_LONGEST_MARK: Final = 64


class Capability(StrEnum):
    """What an agent may be able to do; it tells those that it has."""

    PROBE = "probe"
    DRY_RUN = "dry_run"
    """With PROBE: a cycle that is only driven, above the sphere."""
    SHIFT = "shift"
    SLOPES = "slopes"
    ERRORS = "errors"
    VALUES = "values"


@dataclass(frozen=True, slots=True)
class SlopeTravel:
    """Travel of an agent that takes slopes, in the coordinates of the tip's position."""

    pairs: frozenset[tuple[int, int]]
    """(shifted axis, axis whose position counts); X, Y, Z are 0, 1, 2."""
    reference_mm: Triple
    reach_mm: Triple
    """Largest distance of X, Y, Z from the reference."""


@dataclass(frozen=True, slots=True)
class Greeting:
    """What is used of an agent's greeting."""

    version: int = 1
    can: frozenset[Capability] = frozenset({Capability.PROBE, Capability.SHIFT})
    error_reach_mm: tuple[float, float] | None = None
    """With ERRORS: farthest that a tool's tip gets from where A and C meet, along X and across it."""
    bound_um: float = math.inf
    """With ERRORS: the largest offset that it accepts."""
    travel: SlopeTravel | None = None
    """With SLOPES."""
    poses: int | tuple[tuple[float, float], ...] | None = None
    """With PROBE: A and C of each pose, degrees, or how many there are; None: it does not tell."""
    path: str = ""
    """With PROBE: a mark of all that its path is made of; empty: it does not tell."""

    def check_poses(self, poses: int, poses_deg: tuple[tuple[float, float], ...], device: str) -> None:
        """Raises WrongDevice if the agent's cycle touches others than the configured ones."""
        own = self.poses
        if own is None:
            return
        count = own if isinstance(own, int) else len(own)
        hint = Text("agent_poses_hint")
        if count != poses:
            raise WrongDevice(Text("agent_pose_count", count=count, poses=poses), device=device, hint=hint)
        if isinstance(own, int) or not poses_deg:
            return
        for i, (told, wanted) in enumerate(zip(own, poses_deg, strict=True), start=1):
            if any(_apart_deg(a, b) > _SAME_DEG for a, b in zip(told, wanted, strict=True)):
                found, other = (f"A {a:g} C {c:g}" for a, c in (told, wanted))
                raise WrongDevice(Text("agent_pose", i=i, found=found, other=other), device=device, hint=hint)


def greeting_of(answer: Json, device: str) -> Greeting:
    """From the answer to the first line. Raises BadAnswer for an invalid field, WrongDevice for a newer version."""
    if not isinstance(answer, dict):
        return Greeting()  # of the first agents: a list of their commands
    version = answer.get("version", 1)
    if isinstance(version, bool) or not isinstance(version, int) or version < 1:
        raise BadAnswer(Text("agent_version", version=repr(version)), device=device)
    if version > PROTOCOL_VERSION:
        what = Text("agent_newer", version=version, own=PROTOCOL_VERSION)
        raise WrongDevice(what, device=device, hint=Text("update_gateway"))
    can = _capabilities(answer.get("capabilities", ["probe", "shift"]), device)
    return Greeting(
        version,
        can,
        _reach(answer.get("reach_mm"), device) if Capability.ERRORS in can else None,
        finite_number(answer["bound_um"], "bound_um", device) if "bound_um" in answer else math.inf,
        _travel(answer.get("travel"), device) if Capability.SLOPES in can else None,
        _poses(answer.get("poses"), version, device) if Capability.PROBE in can else None,
        _path(answer.get("path", ""), device) if Capability.PROBE in can else "",
    )


def _capabilities(told: Json, device: str) -> frozenset[Capability]:
    """Unknown ones come from a later agent and do no harm."""
    if not isinstance(told, list) or not all(isinstance(name, str) for name in told):
        raise BadAnswer(Text("agent_capabilities", told=repr(told)), device=device)
    return frozenset(capability for capability in Capability if capability.value in told)


def _reach(told: Json, device: str) -> tuple[float, float]:
    along, across = finite_numbers(told, 2, "reach_mm", device)
    if min(along, across) <= 0:
        raise BadAnswer(Text("agent_reach", told=repr(told)), device=device)
    return along, across


def _travel(told: Json, device: str) -> SlopeTravel:
    travel = json_object(told, "travel", device)
    pairs = travel.get("pairs")
    if not isinstance(pairs, list) or not all(_is_pair(pair) for pair in pairs):
        raise BadAnswer(Text("agent_pairs", pairs=repr(pairs)), device=device)
    reach = triple(travel.get("reach_mm"), "travel.reach_mm", device)
    if min(reach) <= 0:
        raise BadAnswer(Text("agent_travel_reach", reach=repr(reach)), device=device)
    where = (tuple(LINEAR_AXES.index(letter) for letter in str(pair)) for pair in pairs)
    return SlopeTravel(
        frozenset((shifted, over) for shifted, over in where),
        triple(travel.get("reference_mm"), "travel.reference_mm", device),
        reach,
    )


def _is_pair(pair: Json) -> bool:
    return isinstance(pair, str) and len(pair) == 2 and set(pair) <= set(LINEAR_AXES)


def _poses(told: Json, version: int, device: str) -> int | tuple[tuple[float, float], ...] | None:
    if told is None and version < 3:
        return None
    if isinstance(told, list):
        pairs = [finite_numbers(pose, 2, "poses", device) for pose in told]
        return tuple((a, c) for a, c in pairs)
    count = finite_number(told, "poses", device)
    if count < 1 or count != int(count):
        raise BadAnswer(Text("agent_poses", told=repr(told)), device=device)
    return int(count)


def _path(told: Json, device: str) -> str:
    if not isinstance(told, str) or len(told) > _LONGEST_MARK:
        raise BadAnswer(Text("agent_path", told=repr(told), most=_LONGEST_MARK), device=device)
    return told


def _apart_deg(a: float, b: float) -> float:
    """A whole turn is no difference."""
    return abs((a - b + 180.0) % 360.0 - 180.0)
