"""What a probing cycle cannot have commanded, in the control's snapshots while it runs. Pure.

Other programs, modes and moves within a cycle make its result void, also when the control notices nothing and ends the
cycle as usual. What happens between two snapshots, and is undone before the second, is not seen.
"""

from collections.abc import Sequence
from typing import Final

from drivers.base import Quality
from drivers.nc import NcSnapshot, OperatingMode, ProbingState, ProgramState
from gateway.nc.probing.geometry import centre_mm

_BESIDE_MM: Final = 100.0
"""Farther from all of the sphere's places, in X and Y, no cycle goes, however inexact [probing] is."""
_BEYOND_DEG: Final = 2.0
_STANDS: Final = frozenset({ProgramState.STOPPED, ProgramState.INTERRUPTED, ProgramState.ABORTED})
_RUNS: Final = frozenset({ProgramState.RUNNING, ProgramState.WAITING})


class CyclePath:
    """Where a cycle of known programs goes: X, Y and A, but not Z, which depends on the tool's length.

    Parameters
    ----------
    poses_deg: A and C of each pose
    radius_mm, height_mm: of the sphere's centre, as in [probing]
    """

    def __init__(self, poses_deg: Sequence[tuple[float, float]], radius_mm: float, height_mm: float) -> None:
        places = [centre_mm(radius_mm, height_mm, a, c) for a, c in poses_deg]
        self._within = {
            "X": (min(p[0] for p in places) - _BESIDE_MM, max(p[0] for p in places) + _BESIDE_MM),
            "Y": (min(p[1] for p in places) - _BESIDE_MM, max(p[1] for p in places) + _BESIDE_MM),
            "A": (min(a for a, _ in poses_deg) - _BEYOND_DEG, max(a for a, _ in poses_deg) + _BEYOND_DEG),
        }

    def beyond(self, snapshot: NcSnapshot) -> str:
        """The axis that is where no cycle goes; empty: none is."""
        for axis, (low, high) in self._within.items():
            if not low <= snapshot.positions[axis] <= high:
                unit = "°" if axis == "A" else " mm"
                return (
                    f"{axis} was at {snapshot.positions[axis]:.1f}{unit}, where no pose of the cycle leads: if every "
                    "cycle ends so, look at [nc] origin_mm and at the sphere in [probing]"
                )
        return ""


class CycleWatch:
    """The snapshots of one cycle after the other.

    path: None: the path of this control's cycle is not known
    """

    def __init__(self, path: CyclePath | None = None) -> None:
        self._path = path
        self._running = self._seen = False
        self._first: NcSnapshot | None = None
        self._stood = self._said = False
        self._doubt = ""
        """Where a snapshot showed axes or tool: it counts once the cycle is known to have run on after it."""
        self.found = ""
        """What happened in the present or the latest cycle that it did not command; empty: nothing."""

    def begin(self) -> None:
        """A cycle is requested."""
        self._running = self._seen = self._stood = self._said = False
        self._first, self._doubt, self.found = None, "", ""

    def told(self, state: ProbingState) -> None:
        """The state of the cycle, as the control tells it."""
        self._running = state is ProbingState.RUNNING
        if self._running:
            self.found = self.found or self._doubt
        self._doubt = ""

    def look(self, snapshot: NcSnapshot) -> bool:
        """Whether this is the first look at which something is known that the cycle did not command."""
        if self._running and not self.found and snapshot.probing is not False and snapshot.quality is Quality.GOOD:
            self._judge(snapshot)
        said, self._said = self._said, bool(self.found)
        return self._said and not said

    def _judge(self, snapshot: NcSnapshot) -> None:
        if not self._seen:  # it may have been read before the cycle was running
            self._seen = True
            return
        first = self._first = self._first or snapshot
        # In one snapshot alone, some controls tell so between two blocks of a cycle.
        stood, self._stood = self._stood, snapshot.program in _STANDS and first.program in _RUNS
        self.found = _changed(first, snapshot)
        if not self.found and stood and self._stood:
            self.found = f"the program was {snapshot.program.value}"
        # The cycle may have ended since its state was read, and the probe be on its way to the magazine.
        self._doubt = self._doubt or _elsewhere(first, snapshot, self._path)


def _changed(first: NcSnapshot, now: NcSnapshot) -> str:
    unknown = OperatingMode.UNKNOWN
    if now.ready is False and first.ready is not False:
        return "the control was no longer ready"
    if new := sorted(set(now.alarms) - set(first.alarms)):
        return f"alarm {', '.join(map(str, new))}"
    if now.mode is not first.mode and unknown not in (now.mode, first.mode):
        return f"the mode changed from {first.mode.value.upper()} to {now.mode.value.upper()}"
    return ""


def _elsewhere(first: NcSnapshot, now: NcSnapshot, path: CyclePath | None) -> str:
    if None not in (now.tool, first.tool) and now.tool != first.tool:
        return f"tool {now.tool} took the place of tool {first.tool}"
    return "" if path is None else path.beyond(now)
