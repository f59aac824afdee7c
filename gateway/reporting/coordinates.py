"""Coordinates of the tool: for which errors each one is corrected, and why not for the others."""

from dataclasses import dataclass

import numpy as np

from gateway.model.text import Language
from gateway.reporting.data import ReportData
from talc.frame import BoolArray
from talc.kinematics import largest_offsets

_LEAST_SHARE = 0.005
"""Least share of the steps: what is rounded to 0 % is not told."""
_MOVE = largest_offsets((1.0, 1.0), 1.0) > 0
"""(3, 9) which errors move X, Y, Z anywhere in the travel."""


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
    said = Language(data.language)
    if data.mode != "compensate":
        return _untouched(said, said("report_coordinate.mode", mode=data.mode))
    if data.judged_from is None:
        return _untouched(said, said("report_coordinate.not_begun"))
    return tuple(_row(data, axis, data.judged_from, said) for axis in range(3))


def _untouched(said: Language, why: str) -> tuple[CoordinateRow, ...]:
    return tuple(CoordinateRow(axis, said("report_coordinate.nothing"), why) for axis in "XYZ")


def _row(data: ReportData, axis: int, first: int, said: Language) -> CoordinateRow:
    known = np.isfinite(data.corrected[first:])
    trusted = np.ones_like(known) if data.trusted is None else data.trusted[first:]
    # Without a model an error is corrected by what was measured last; the learner has a model of every error.
    modelled = np.isfinite(data.predicted[first:])
    done, without = list[str](), list[str]()
    for e in np.flatnonzero(_MOVE[axis]):
        ok = known[:, e] & trusted[:, e]
        cases = (
            (done, "corrected", ok & modelled[:, e]),
            (done, "last_measurement", ok & ~modelled[:, e]),
            (without, "neither", ~known[:, e]),
            (without, "no_better", known[:, e] & ~trusted[:, e]),
        )
        for told, key, steps in cases:
            if steps.mean() >= _LEAST_SHARE:
                told.append(said(f"report_coordinate.{key}", error=data.labels[e], share=_share(steps, said)))
    return CoordinateRow("XYZ"[axis], ", ".join(done) or said("report_coordinate.nothing"), "; ".join(without))


def _share(steps: BoolArray, said: Language) -> str:
    """The share of the steps in words, unless it is all of them."""
    return "" if steps.all() else said("report_coordinate.share", percent=100.0 * float(steps.mean()))
