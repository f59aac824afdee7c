"""The axes of a machine with a touch probe: every move is sampled along its path, in machine coordinates.

The positions are those of the axes (X, Y, Z in mm, A, C in degrees), not of the tool's tip; C counts its turns. What
the probe meets is the caller's geometry, a function of the positions.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.words import AXES

Floats = NDArray[np.float64]
DENSITY: Final = 0.5
"""Farthest that two samples of a path are apart, mm and degrees."""
ACCELERATION_MM_S2, CYCLE_S = 1000.0, 0.01
"""How a move is braked when the probe switches: after one cycle, along the path."""
ROUNDING_MM: Final = 5.0
"""How far before a block's end its path may turn to the next one in continuous-path mode."""
_FINER: Final = np.linspace(0.0, 1.0, 101)


class Reset(Exception):
    """The operator has pressed RESET: the program ends where it is."""


@dataclass(frozen=True, slots=True)
class Move:
    """One block that moved axes."""

    path: Floats
    """(n, 5) positions, start and end included."""
    measures: bool
    """MEAS: it ends where the probe switches."""
    met: bool
    """It did."""
    feed: float
    """mm/min, or degrees/min if only rotary axes move."""
    from_rest: bool
    """The move before it ended at exact stop fine."""
    tool: int
    """What was in the spindle."""
    modal: Mapping[int, str]
    """G functions in force."""
    spindle: str
    """"turns", "stands" or its angle."""
    fluid: int
    """7, 8, or 9: off."""


@dataclass(slots=True)
class Path:
    """What a block asks of the axes."""

    end: Mapping[str, float]
    """End points in machine coordinates; a missing axis stands still."""
    shortest: frozenset[str]
    """Modulo axes that go the shortest way."""
    feed: float
    measures: bool
    exact: bool
    """Exact stop fine at its end; otherwise its corner may be rounded."""
    modal: Mapping[int, str]


def _no_hook(_: int) -> None: ...


@dataclass(slots=True)
class Axes:
    """Positions, limits, probe and spindle, and every move that there was.

    gap: (n, 5) positions -> (n,) how far the probe's ball is from what it could touch; 0 or less: deflected
    """

    position: dict[str, float]
    limits: Mapping[str, tuple[float, float]]
    gap: Callable[[Floats], Floats]
    tool: int = 0
    spindle: str = "stands"
    fluid: int = 9
    probe_on: bool = False
    """Without it the probe does not switch."""
    stuck: bool = False
    """The probe reports that it is deflected, whatever it touches."""
    homed: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(AXES, True))
    moves: list[Move] = field(default_factory=list)
    triggered: bool = False
    """$AC_MEA of the last measuring block."""
    latched: dict[str, float] = field(default_factory=lambda: dict.fromkeys(AXES, 0.0))
    """$AA_MM: positions when the probe switched last."""
    before: Callable[[int], None] = _no_hook
    """Called before each move with its number: what happens at the machine meanwhile."""
    after: Callable[[int], None] = _no_hook
    """Called after it."""
    jogged: dict[int, Mapping[str, float]] = field(default_factory=dict)
    """By number of a move: it is stopped on its first quarter, and the axes are moved by hand by this much."""
    _from_rest: bool = True

    @property
    def deflected(self) -> bool:
        return self.stuck or (self.probe_on and bool(self.gap(self._row())[0] <= 0.0))

    def switch(self, on: float) -> None:
        """Switch the probe on (1) or off (0). Raises ProgramAlarm for what the machine builder's hook does not know."""
        if on not in (0, 1):
            raise ProgramAlarm(f"TALC_SWITCH({on:g}): expected 0 or 1")
        self.probe_on = bool(on)

    def run(self, path: Path, following: Path | None) -> None:
        """Move along a block; following: the next one, if it is known already. Raises ProgramAlarm and Reset."""
        self.before(len(self.moves))
        start, end = self._row()[0], self._end(path)
        points = [start, end]
        if by_hand := self.jogged.get(len(self.moves)):
            stopped = start + (end - start) / 4
            points = [start, stopped, stopped + [by_hand.get(axis, 0.0) for axis in AXES], end]
        if not np.any(end != start):
            if path.measures:
                raise ProgramAlarm("a measuring block without a motion")
            return
        if path.measures and self.deflected:
            raise ProgramAlarm("21700: the probe is deflected already")
        if following is not None and not path.exact:
            points[-1] = end + (start - end) * min(0.5, ROUNDING_MM / max(float(np.linalg.norm(end - start)), 1e-9))
        samples = np.vstack([_sampled(one, two) for one, two in pairwise(points)])
        if path.measures:
            self.triggered = False
            samples = self._until_switched(samples, path.feed)
        met, rest = path.measures and self.triggered, self._from_rest
        self.moves.append(
            Move(samples, path.measures, met, path.feed, rest, self.tool, path.modal, self.spindle, self.fluid)
        )
        self.position = dict(zip(AXES, map(float, samples[-1]), strict=True))
        self._from_rest = path.exact
        self.after(len(self.moves) - 1)

    def _row(self) -> Floats:
        return np.array([[self.position[axis] for axis in AXES]])

    def _end(self, path: Path) -> Floats:
        end = dict(self.position)
        for axis, value in path.end.items():
            if axis in path.shortest:
                turn = math.remainder(value - end[axis], 360.0)
                value = end[axis] + turn
            low, high = self.limits[axis]
            if not low <= value <= high:
                raise ProgramAlarm(f"10720: {axis}={value:g} is outside its software limits {low:g} to {high:g}")
            end[axis] = value
        return np.array([end[axis] for axis in AXES])

    def _until_switched(self, samples: Floats, feed: float) -> Floats:
        """Cut where the probe switches, after braking. Latches the position."""
        inside = np.flatnonzero(self.gap(samples) <= 0.0)
        if not (inside.size and self.probe_on):
            return samples
        low, high = samples[inside[0] - 1], samples[inside[0]]
        for _ in range(4):
            between = low + (high - low) * _FINER[:, None]
            first = int(np.flatnonzero(self.gap(between) <= 0.0)[0])
            low, high = between[max(0, first - 1)], between[first]
        self.triggered = True
        self.latched = dict(zip(AXES, map(float, high), strict=True))
        speed = feed / 60.0
        on = speed * CYCLE_S + speed**2 / (2 * ACCELERATION_MM_S2)
        rest = samples[-1] - high
        length = float(np.linalg.norm(rest))
        stop = samples[-1] if length <= on else high + rest * (on / length)
        return np.vstack([samples[: inside[0]], high[None], stop[None]])


def _sampled(start: Floats, end: Floats) -> Floats:
    count = max(1, math.ceil(float(np.max(np.abs(end - start))) / DENSITY))
    return start + (end - start) * (np.arange(count + 1) / count)[:, None]
