"""Coordinates of the tool: for which errors each one is corrected, and why not for the others."""

from dataclasses import dataclass

import numpy as np

from gateway.reporting.data import ReportData
from talc.frame import BoolArray
from talc.kinematics import largest_offsets

_LEAST_SHARE = 0.005
"""Least share of the steps: what is rounded to 0 % is not told."""
_MOVE = largest_offsets((1.0, 1.0), 1.0) > 0
"""(3, 9) which errors move X, Y, Z anywhere in the travel."""
_NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class CoordinateRow:
    """One coordinate of the tool, as texts."""

    name: str
    corrected: str
    """The errors that it is corrected for, or `nothing`."""
    not_corrected: str
    """The others, each with its reason; empty: there is none."""


def by_coordinate(data: ReportData) -> tuple[CoordinateRow, ...]:
    """X, Y and Z at the tool, over the steps since corrections began; none of a recording, which has no tool."""
    if data.recorded is not None:
        return ()
    if data.mode != "compensate":
        return _untouched(f"[compensation] mode is '{data.mode}': nothing is written to the control")
    if data.judged_from is None:
        return _untouched("no correction has begun: see what is missing, or the calibration is not over")
    return tuple(_row(data, axis, data.judged_from) for axis in range(3))


def _untouched(why: str) -> tuple[CoordinateRow, ...]:
    return tuple(CoordinateRow(axis, _NOTHING, why) for axis in "XYZ")


def _row(data: ReportData, axis: int, first: int) -> CoordinateRow:
    known = np.isfinite(data.corrected[first:])
    trusted = np.ones_like(known) if data.trusted is None else data.trusted[first:]
    # Without a model an error is corrected by what was measured last; the learner has a model of every error.
    modelled = np.isfinite(data.predicted[first:])
    done, without = [], []
    for e in np.flatnonzero(_MOVE[axis]):
        name, ok = data.labels[e], known[:, e] & trusted[:, e]
        if _told(ok & modelled[:, e]):
            done.append(name + _share(ok & modelled[:, e]))
        if _told(ok & ~modelled[:, e]):
            done.append(f"{name} by its last measurement{_share(ok & ~modelled[:, e])}")
        if _told(~known[:, e]):
            without.append(f"{name}: it has neither a model nor a measurement{_share(~known[:, e])}")
        if _told(known[:, e] & ~trusted[:, e]):
            without.append(
                f"{name}: its estimate is no better than no correction{_share(known[:, e] & ~trusted[:, e])}"
            )
    return CoordinateRow("XYZ"[axis], ", ".join(done) or _NOTHING, "; ".join(without))


def _told(steps: BoolArray) -> bool:
    return bool(steps.mean() >= _LEAST_SHARE)


def _share(steps: BoolArray) -> str:
    """The share of the steps in words, unless it is all of them."""
    return "" if steps.all() else f" ({steps.mean():.0%} of the steps)"
