"""The nine errors on the NC as in TALC_ERRORS: slewed, and turned into K0 wherever the axes are. Knows no protocol.

It does what the generated program must do, and is exact at any time step. To interpret the program in each of its
cycles, an emulated control would need hours for a run of days. A test compares the two.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simulators.nc.cycle import CycleState
from simulators.nc.watchdog import R_OWNER, R_RAMP, R_WATCH, Watchdog, WatchState

R_CYCLE, R_VERSION, R_WANTED, R_IN_FORCE, R_ECHO, R_PROBED, R_TERMS = 65, 99, 100, 110, 119, 120, 123
R_TOOL, R_TOOL_RANGE = 135, 136
"""R-parameters of the probing cycle's state, and of the program (docs/nc.md, Nine errors)."""
R_COUNT_WITH_ERRORS = 137
_VERSION = 3
_ERRORS = 9
ShiftOfTool = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
"""(3,) of X, Y, Z, µm, unless it says otherwise."""
_BRIDGED_UM, _IMPLAUSIBLE_UM = 1e-6, 1e6


@dataclass(frozen=True, slots=True)
class FollowingTerms:
    """Limits and sizes of the program, whatever a gateway writes. X, Y, Z are measured from where A and C meet."""

    slew_um_per_s: float
    radius_mm: float
    """Radius to which ER0T refers."""
    bound_um: tuple[float, float, float]
    reach_mm: tuple[float, float]
    """Largest distance of the tool from where A and C meet, along X and across it, with the tool of the origin if its
    length is known, else with any."""
    tool_range_mm: float = 300.0
    """How far a tool may be longer or shorter than the one of the origin."""
    origin_tool_mm: float | None = 0.0
    """Length of that one; None: the gateway tells by how much the tool in use is longer."""


class ErrorFollower:
    """Advances with time; works on the control's own R-parameters and K0.

    Parameters
    ----------
    r: all R-parameters, R_COUNT_WITH_ERRORS at least
    k0_mm: SD43900 of X, Y, Z
    sign: of K0: -1 if a positive value moves the tool in the negative direction
    watchdog: has R96, and writes no offsets itself
    positions: X Y Z in mm, A C in degrees at a time
    tool_mm: length of the tool in use; 0: none is in force
    """

    def __init__(
        self,
        terms: FollowingTerms,
        r: list[float],
        k0_mm: list[float],
        sign: int,
        watchdog: Watchdog,
        positions: Callable[[float], Sequence[float]],
        tool_mm: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._terms, self._r, self._k0_mm, self._sign = terms, r, k0_mm, sign
        self._watchdog, self._positions, self._tool_mm = watchdog, positions, tool_mm
        self._bound = np.array(terms.bound_um)
        self._now_s = 0.0
        self.power_on(0.0)

    def power_on(self, now_s: float) -> None:
        """Nothing is in force, and the program shows its version and terms."""
        self._now_s = now_s
        self._force: ShiftOfTool = np.zeros(_ERRORS)
        self._bridge: ShiftOfTool = np.zeros(3)
        self._out: ShiftOfTool = np.zeros(3)
        self._held, self._seen, self._tool = False, (-1.0, -1.0, False), 0.0
        self._r[R_WANTED:] = [0.0] * (len(self._r) - R_WANTED)
        terms = self._terms
        told = (terms.slew_um_per_s, terms.radius_mm, *terms.bound_um, *terms.reach_mm)
        self._r[R_TERMS : R_TERMS + len(told)] = told
        self._r[R_TOOL_RANGE] = terms.tool_range_mm * (1.0 if terms.origin_tool_mm is None else -1.0)
        self._r[R_VERSION] = float(_VERSION)

    def advance(self, now_s: float) -> None:
        """Let time pass. Called when the cycle's state has changed, too."""
        if not self._watchdog.runs or (now_s <= self._now_s and self._seen == self._states):
            return  # not even one of its cycles has passed
        if (silent_s := self._watchdog.silent_from_s) < now_s:
            self._until(silent_s)
        self._until(now_s)

    def shift_um(self, positions: Sequence[float]) -> ShiftOfTool:
        """(3,) the shift with the errors in force, unless it is held. positions: X Y Z in mm, A C in degrees."""
        return self._within_bound(self._target(positions) + self._bridge)

    @property
    def held_um(self) -> ShiftOfTool:
        """(3,) the shift held while the control probed, or at the end of a cycle that no gateway compensated."""
        return np.array(self._r[R_PROBED : R_PROBED + 3]) * 1e3

    @property
    def _states(self) -> tuple[float, float, bool]:
        return self._r[R_CYCLE], self._r[R_WATCH], self._r[R_OWNER] > 0

    @property
    def _longer_mm(self) -> float:
        """By how much the tool in use is longer than the one of the origin. One beyond the range changes nothing."""
        if self._terms.origin_tool_mm is not None and (length := self._tool_mm()):
            self._r[R_TOOL] = length - self._terms.origin_tool_mm
        told = self._r[R_TOOL]
        return told if abs(told) <= self._terms.tool_range_mm else self._tool

    def _until(self, now_s: float) -> None:
        passed_s, self._now_s = max(0.0, now_s - self._now_s), max(now_s, self._now_s)
        self._want_nothing_if_silent()
        if not self._held:
            self._move(passed_s)
        self._watchdog.advance(now_s)
        self._want_nothing_if_silent()
        r, touching = self._r, self._r[R_CYCLE] == CycleState.RUNNING
        held = touching and r[R_WATCH] == WatchState.ALIVE
        if not held:
            here = self._positions(now_s)
            if self._held or self._tool != self._longer_mm:
                self._tool = self._longer_mm
                self._bridge = self._out - self._target(here)
            self._out = self.shift_um(here)
        if touching:
            r[R_PROBED : R_PROBED + 3] = (self._out * 1e-3).tolist()
        self._held = held
        self._k0_mm[:] = (self._sign * self._out * 1e-3).tolist()
        r[R_IN_FORCE : R_IN_FORCE + _ERRORS] = self._force.tolist()
        self._seen = self._states

    def _want_nothing_if_silent(self) -> None:
        if self._r[R_WATCH] == WatchState.SILENT and self._r[R_RAMP] > 0:
            self._r[R_WANTED : R_WANTED + _ERRORS] = [0.0] * _ERRORS

    def _move(self, passed_s: float) -> None:
        """Half of the slew removes the bridge; until it is gone, the errors have the other half."""
        slew = self._terms.slew_um_per_s
        alive = self._r[R_WATCH] == WatchState.ALIVE
        rate = slew if alive else min(slew, self._r[R_RAMP] * 1e3)
        bridged_s = 0.0
        if np.abs(self._bridge).sum() > _BRIDGED_UM:
            bridged_s = min(passed_s, float(np.abs(self._bridge).max()) / (0.5 * slew))
        reach = rate * (passed_s - 0.5 * bridged_s)
        self._bridge = self._bridge - np.clip(self._bridge, -0.5 * slew * passed_s, 0.5 * slew * passed_s)
        way = np.array(self._r[R_WANTED : R_WANTED + _ERRORS]) - self._force
        far = self._farthest(np.abs(way).tolist())
        if far <= reach:
            self._force = self._force + way
        elif far < _IMPLAUSIBLE_UM:
            self._force = self._force + way * (reach / far)

    def _farthest(self, way: list[float]) -> float:
        """Largest move of an axis within reach for this change of the nine errors, µm; infinite for a NaN."""
        if not all(map(math.isfinite, way)):
            return math.inf
        ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c = way
        along, across = (reach * 1e-3 for reach in self._terms.reach_mm)
        across += 1e-3 * abs(self._tool) * (self._terms.origin_tool_mm is not None)
        grown = er0t / self._terms.radius_mm * 1e3
        x = ex0c + grown * along + (eb0c + ec0c) * across
        return max(x, max(ey0a, ez0a) + ey0c + ez0t + (grown + ea0c) * across + (eb0c + ec0c) * along)

    def _target(self, positions: Sequence[float]) -> ShiftOfTool:
        """The bounded shift for the errors in force. The chain is that of docs/agent.md; C has no effect."""
        x, y, z, a, _ = positions
        z -= self._tool
        cos, sin = math.cos(math.radians(a)), math.sin(math.radians(a))
        px, py, pz = x * 1e-3, (cos * y + sin * z) * 1e-3, (cos * z - sin * y) * 1e-3
        ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c = self._force
        grown = er0t / self._terms.radius_mm * 1e3
        dx = ex0c + grown * px + eb0c * pz - ec0c * py
        dy = ey0c + grown * py - ea0c * pz + ec0c * px
        dz = ez0t + ea0c * py - eb0c * px
        shift = np.array([dx, ey0a + cos * dy - sin * dz, ez0a + sin * dy + cos * dz])
        return self._within_bound(shift)

    def _within_bound(self, shift: ShiftOfTool) -> ShiftOfTool:
        within: ShiftOfTool = np.minimum(np.maximum(shift, -self._bound), self._bound)
        return within
