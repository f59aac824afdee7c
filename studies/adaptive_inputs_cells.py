"""The study adaptive-inputs beside Z22's Tables 3 and 4 and the figures of its text, from the page's own tables."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from studies.adaptive_inputs_pictures import limits_of
from studies.frame import Run
from studies.page import Rows, Table, TableRow, columns
from studies.printed import Z22_COLUMNS_3, Z22_COLUMNS_4, Z22_TABLE_4, cell_table
from talc.frame import FloatArray
from talc.indicators import reduction
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

_SIX = np.array([ERROR_UNITS[name] == MICROMETRE for name in THERMAL_ERRORS])
_PARTS = {"six": _SIX, "three rotations": ~_SIX}
_EX0C, _ER0T = (THERMAL_ERRORS.index(name) for name in ("EX0C", "ER0T"))
_STATIC, _ADAPTIVE, _TCK = "pso, static", "pso, adaptive", "tck, adaptive"
_SIZES = "another machine: its errors have other sizes"
_EXPLAINED = "in the simulation the inputs explain more of it"
_ROOM = "theirs is small and hardly moved; ours is among the largest, so there is more to reduce"
_SIXTH = "without compensation our EX0C is a sixth (E_RMS: an eighth) of theirs"
_TENTH = "without compensation our EY0C is a tenth (E_RMS: a seventh) of theirs"
_NOISE = "ours is hardly larger than the probing noise, or smaller"
WHY: Mapping[str, str] = {
    **{f"Table {n}, {error}": _EXPLAINED for n in (3, 4) for error in ("EZ0A", "EZ0T", "ER0T")},
    **{f"Table {n}, EY0A": _ROOM for n in (3, 4)},
    **{f"Table {n}, EX0C": _SIXTH for n in (3, 4)},
    **{f"Table {n}, EY0C": _TENTH for n in (3, 4)},
    **{f"Table {n}, {error}": _NOISE for n in (3, 4) for error in ("EA0C", "EB0C", "EC0C")},
    **{f"Table {n}, EA0C, E_RMS": _EXPLAINED for n in (3, 4)},
    **{f"Table 3, {error}, {name}, uncompensated": _SIZES for error in THERMAL_ERRORS for name in ("E_PV", "E_RMS")},
    "text, reduction of E_PV of three rotations, Group-LASSO over TCK, % higher": "here E_PV is not reduced",
    "text": "another machine and other noise in each repetition, where theirs share one recording",
}
MISSING = "its run was not made"


def against_none(peak: Table, rms: Table) -> Table:
    """Reduction against no compensation, %: the paper's Table 4, and ours for each selector."""
    rows = []
    for name, table in (("E_PV", peak), ("E_RMS", rms)):
        means = _means(table)
        for place, inputs in enumerate(Z22_COLUMNS_4):
            theirs = [Z22_TABLE_4[name][error][place] for error in THERMAL_ERRORS]
            rows.append(TableRow((f"paper: {name}, {inputs}", *(f"{v:g}" for v in theirs)), paper=True))
            ways = [f"{selector}, {inputs}" for selector in ("pso", "tck", "search", "learner")]
            rows += [
                TableRow((f"{name}, {way}", *(f"{v:.0f}" for v in _less(means["none"], means[way]))))
                for way in ways
                if way in means
            ]
    return Table(("less than without compensation, %", *THERMAL_ERRORS), tuple(rows))


def against_static(peak: Table, rms: Table) -> Table:
    """Reduction by inputs that are chosen again, %, against those that are kept; the paper has no such table."""
    rows = []
    for selector, (name, table) in product(("pso", "tck", "search"), (("E_PV", peak), ("E_RMS", rms))):
        means = _means(table)
        if {f"{selector}, static", f"{selector}, adaptive"} <= set(means):
            less = _less(means[f"{selector}, static"], means[f"{selector}, adaptive"])
            rows.append(
                TableRow((f"{selector}: {name}", *(f"{v:.0f}" for v in less), f"{float(less[_SIX].mean()):.0f}"))
            )
    return Table(("adaptive against static, % less", *THERMAL_ERRORS, "mean of six"), tuple(rows))


def beside_paper(
    peak: Table, rms: Table, updates: Table, course: Rows | None, chosen: Rows | None, static: Sequence[Run] = ()
) -> Table:
    """A line for each figure that Z22 prints.

    peak, rms, updates: the page's tables of E_PV, E_RMS and model updates; course, chosen: figures of the pictures over
    time of `pso` with adaptive inputs, if there are any; static: its single run with static inputs.
    """
    ours: dict[str, float] = {}
    for name, table in (("E_PV", peak), ("E_RMS", rms)):
        means = _means(table)
        if not {"none", _STATIC, _ADAPTIVE} <= set(means):
            continue
        for e, error in enumerate(THERMAL_ERRORS):
            before, after = means["none"][e], means[_ADAPTIVE][e]
            for head, value in zip(Z22_COLUMNS_3, (before, after, reduction(before, after)), strict=True):
                unit = "" if head.endswith("%") else f", {ERROR_UNITS[error]}"
                ours[f"Table 3, {error}, {name}, {head}{unit}"] = value
            for inputs in Z22_COLUMNS_4:
                ours[f"Table 4, {error}, {name}, reduction, {inputs}, %"] = reduction(
                    before, means[f"pso, {inputs}"][e]
                )
    text = _text(peak, rms) | _updated(updates) | _single_run(course, chosen, static)
    ours |= {f"text, {name}": value for name, value in text.items()}
    return cell_table("Z22", ours, WHY, MISSING)


def _text(peak: Table, rms: Table) -> dict[str, float]:
    """A deviation of several errors is the mean of their own ones (k = 2)."""
    means, spreads = ({"E_PV": of(peak), "E_RMS": of(rms)} for of in (_means, _spreads))
    if not {_STATIC, _ADAPTIVE, _TCK} <= set(means["E_PV"]):
        return {}
    found: dict[str, float] = {}
    for title, way in (("static", _STATIC), ("adaptive", _ADAPTIVE), ("TCK", _TCK)):
        found[f"mean E_PV of six, {title}, µm"] = float(means["E_PV"][way][_SIX].mean())
    for title, way in (("static", _STATIC), ("adaptive", _ADAPTIVE)):
        found[f"mean deviation (k = 2) of E_PV of six, {title}, µm"] = float(spreads["E_PV"][way][_SIX].mean())
        for name, of_way in means.items():
            found[f"{name} of EX0C, {title}, µm"] = float(of_way[way][_EX0C])

    def less(name: str, of: Mapping[str, FloatArray], before: str, after: str, errors: Any) -> None:
        found[f"{name}, % less"] = reduction(float(np.mean(of[before][errors])), float(np.mean(of[after][errors])))

    for name, part in product(means, _PARTS):
        less(f"deviation of {name} of {part}, adaptive against static", spreads[name], _STATIC, _ADAPTIVE, _PARTS[part])
        ours, theirs = (
            float(_less(means[name]["none"], means[name][way])[_PARTS[part]].mean()) for way in (_ADAPTIVE, _TCK)
        )
        if ours > 0 and theirs > 0:  # a ratio of reductions says nothing where there is none
            found[f"reduction of {name} of {part}, Group-LASSO over TCK, % higher"] = 100 * (ours / theirs - 1)
    less("E_PV of EX0C, adaptive against static", means["E_PV"], _STATIC, _ADAPTIVE, _EX0C)
    less("deviation of E_PV of EX0C, adaptive against static", spreads["E_PV"], _STATIC, _ADAPTIVE, _EX0C)
    less("deviation of E_PV of six, Group-LASSO against TCK", spreads["E_PV"], _TCK, _ADAPTIVE, _SIX)
    less("deviation of E_PV of ER0T, Group-LASSO against TCK", spreads["E_PV"], _TCK, _ADAPTIVE, _ER0T)
    return found


def _updated(updates: Table) -> dict[str, float]:
    found: dict[str, float] = {}
    for row in updates.rows:
        if row.cells[0] in (_STATIC, _ADAPTIVE):
            inputs = row.cells[0].partition(", ")[2]
            mean, spread = _pair(row.cells[1])
            found |= {f"model updates, {inputs}": mean, f"deviation (k = 2) of model updates, {inputs}": spread}
    return found


def _single_run(course: Rows | None, chosen: Rows | None, static: Sequence[Run]) -> dict[str, float]:
    found: dict[str, float] = {}
    for run in static:
        found["model updates of the single run, static"] = float(len(run.result["updates"]))
        found["limit of EX0C in the single run, static, µm"] = limits_of(run, _EX0C)[1]
    if chosen is not None:
        found["model updates of the single run, adaptive"] = len(chosen) - 2.0  # the first ends the calibration
    known = () if course is None else columns(course)["EX0C limit"]
    limits = [float(cell) for cell in known if cell not in ("", "nan")]
    if limits:
        found["least limit of EX0C in the single run, adaptive, µm"] = min(limits)
        found["largest limit of EX0C in the single run, adaptive, µm"] = max(limits)
    return found


def _pair(cell: str) -> tuple[float, float]:
    """Mean, and twice the standard deviation, of a cell `6.7 ± 1.5`."""
    mean, _, spread = cell.partition(" ± ")
    return float(mean), float(spread or 0.0)


def _own(table: Table) -> Mapping[str, Sequence[str]]:
    return {row.cells[0]: row.cells[1 : 1 + len(THERMAL_ERRORS)] for row in table.rows if not row.paper}


def _means(table: Table) -> Mapping[str, FloatArray]:
    return {name: np.array([_pair(cell)[0] for cell in cells]) for name, cells in _own(table).items()}


def _spreads(table: Table) -> Mapping[str, FloatArray]:
    return {name: np.array([_pair(cell)[1] for cell in cells]) for name, cells in _own(table).items()}


def _less(before: FloatArray, after: FloatArray) -> FloatArray:
    return np.array([reduction(b, a) for b, a in zip(before.tolist(), after.tolist(), strict=True)])
