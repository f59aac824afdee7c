"""The machine's program as a pure function of time: a seeded sequence of operations with mean speeds.

Z22 loads the machine with random load cases of five minutes; B19 varies C axis speed and cutting fluid in longer
blocks, with standstill between them. A load case here combines both. It is indexed by the clock and not by the number
of parts made: time lost to probing does not shift the rest of the day, so runs of different methods see the same loads.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

_DAY_S = 86400.0
_GRID_S = 300.0
_OPERATION_S = 45.0


class Activity(StrEnum):
    """The activity in a block of the day."""

    ROUGHING = "roughing"
    FINISHING = "finishing"
    TURNING = "turning"
    SINGLE_AXIS = "single_axis"
    PAUSE = "pause"
    NIGHT = "night"


CUTTING = frozenset({Activity.ROUGHING, Activity.FINISHING, Activity.TURNING, Activity.SINGLE_AXIS})


@dataclass(frozen=True, slots=True)
class MeanLoads:
    """What heats the machine: mean magnitudes of speed, and cutting fluid."""

    x: float = 0.0
    """mm/min; likewise y and z."""
    y: float = 0.0
    z: float = 0.0
    a: float = 0.0
    """1/min; likewise c and spindle."""
    c: float = 0.0
    spindle: float = 0.0
    coolant: float = 0.0
    """Cutting fluid: 1 on, 0 off; a mean over time lies between."""

    def as_tuple(self) -> tuple[float, float, float, float, float, float, float]:
        return self.x, self.y, self.z, self.a, self.c, self.spindle, self.coolant


@dataclass(frozen=True, slots=True)
class DayPart:
    """A stretch of the day with constant mean speeds: start <= time < end."""

    start_s: float
    end_s: float
    kind: Activity
    loads: MeanLoads

    @property
    def cutting(self) -> bool:
        return self.kind in CUTTING


class LoadCase:
    """Consecutive blocks from 0 s on; the last one never ends.

    Parameters
    ----------
    blocks: non-empty, without gaps, in order of time
    operation_s: length of one operation inside a block; between operations (tool change) the program can be
        interrupted

    Raises ValueError when the blocks leave gaps or overlap.
    """

    def __init__(self, blocks: Sequence[DayPart], *, operation_s: float = _OPERATION_S) -> None:
        if not blocks or blocks[0].start_s != 0.0:
            raise ValueError("blocks: expected at least one, the first starting at 0 s")
        for before, after in pairwise(blocks):
            if before.end_s != after.start_s or not after.end_s > after.start_s:
                raise ValueError(f"blocks: {before.end_s} s is followed by {after.start_s} s to {after.end_s} s")
        if not operation_s > 0:
            raise ValueError(f"operation_s = {operation_s!r}: expected more than 0")
        self.blocks = tuple(blocks)
        self.operation_s = operation_s
        self._starts = [block.start_s for block in blocks]
        self._loads = np.array([block.loads.as_tuple() for block in blocks])
        lengths = np.array([[block.end_s - block.start_s] for block in blocks])
        self._integral = np.vstack([np.zeros((1, 7)), np.cumsum(self._loads * lengths, axis=0)])

    @classmethod
    def random(cls, seed: int, duration_s: float, *, start_hour: float = 0.0, nights: bool = True) -> "LoadCase":
        """A day-and-night sequence of random blocks covering at least `duration_s`.

        Parameters
        ----------
        seed: same seed, same load case, whatever else runs
        start_hour: hour of the day at time 0; some nights (about 22 h to 5 h) the machine stands still
        nights: False for a machine that never stops
        """
        draw = np.random.default_rng(seed)
        stops = _nights(draw, duration_s, start_hour) if nights else []
        blocks: list[DayPart] = []
        now = 0.0
        while now < duration_s:
            if stops and stops[0][0] <= now:
                end = max(stops.pop(0)[1], now + _GRID_S)
                blocks.append(DayPart(now, end, Activity.NIGHT, MeanLoads()))
            else:
                kind = Activity(draw.choice([k.value for k in _MIX], p=list(_MIX.values())))
                end = now + _GRID_S * round(math.exp(draw.uniform(0.0, math.log(24.0))))  # 5 min to 2 h
                if stops:
                    end = min(end, max(stops[0][0], now + _GRID_S))
                blocks.append(DayPart(now, end, kind, _loads(kind, draw)))
            now = end
        return cls(blocks)

    def at(self, time_s: float) -> DayPart:
        """The block in force at a time; before 0 s the first one."""
        return self.blocks[max(0, bisect_right(self._starts, time_s) - 1)]

    def integral(self, time_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """(7,) loads integrated from 0 s, in the order of MeanLoads, unit times seconds."""
        index = max(0, bisect_right(self._starts, time_s) - 1)
        total: np.ndarray[tuple[int], np.dtype[np.float64]] = self._integral[index] + self._loads[index] * (
            time_s - self._starts[index]
        )
        return total

    def next_safe_point(self, time_s: float) -> float:
        """First time from `time_s` on when the program may be interrupted.

        At standstill that is at once; otherwise at the end of the running operation or block.
        """
        block = self.at(time_s)
        if not block.cutting:
            return time_s
        operations = math.ceil((time_s - block.start_s) / self.operation_s)
        return min(block.start_s + operations * self.operation_s, block.end_s)


_MIX = {
    Activity.ROUGHING: 0.28,
    Activity.FINISHING: 0.22,
    Activity.TURNING: 0.18,
    Activity.SINGLE_AXIS: 0.14,
    Activity.PAUSE: 0.18,
}


def _loads(kind: Activity, draw: np.random.Generator) -> MeanLoads:
    wet = float(draw.random() < 0.6)
    match kind:
        case Activity.ROUGHING:
            x, y, z = draw.uniform(300.0, 2500.0, 3)
            a, c = draw.uniform(0.0, 0.5, 2)
            return MeanLoads(x, y, z, a, c, float(draw.uniform(2000.0, 8000.0)), wet)
        case Activity.FINISHING:
            x, y, z = draw.uniform(1000.0, 6000.0, 3)
            a, c = draw.uniform(0.5, 6.0, 2)
            return MeanLoads(x, y, z, a, c, float(draw.uniform(8000.0, 16000.0)), wet)
        case Activity.TURNING:
            x, _, z = draw.uniform(50.0, 600.0, 3)
            return MeanLoads(x, 0.0, z, 0.0, float(draw.uniform(200.0, 1000.0)), 0.0, wet)
        case Activity.SINGLE_AXIS:
            axis = str(draw.choice(["x", "y", "z", "a", "c", "spindle"]))
            low, high = _SINGLE[axis]
            return MeanLoads(**{axis: float(draw.uniform(low, high)), "coolant": wet})
        case Activity.PAUSE | Activity.NIGHT:
            return MeanLoads()


_SINGLE = {
    "x": (4000.0, 12000.0),
    "y": (4000.0, 12000.0),
    "z": (4000.0, 12000.0),
    "a": (3.0, 15.0),
    "c": (200.0, 1200.0),  # B19 turns the table at up to 1,200 1/min
    "spindle": (4000.0, 18000.0),
}


def _nights(draw: np.random.Generator, duration_s: float, start_hour: float) -> list[tuple[float, float]]:
    stops = []
    for day in range(-1, math.ceil((duration_s / 3600.0 + start_hour) / 24.0) + 1):
        begin, length, stands = draw.uniform(21.0, 23.0), draw.uniform(5.0, 8.0), draw.random() < 0.6
        start = day * _DAY_S + (begin - start_hour) * 3600.0
        start = _GRID_S * round(start / _GRID_S)
        end = start + _GRID_S * round(length * 3600.0 / _GRID_S)
        if stands and end > 0.0:
            stops.append((start, end))
    return stops
