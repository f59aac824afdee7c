"""Pictures of the study adaptive-inputs: bars, errors and limits over time, chosen inputs, static against adaptive."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from simulators.cases import LONG_TERM_H
from studies.frame import Run
from studies.page import Picture, Rows, columns, figure
from talc.frame import FloatArray
from talc.names import ERROR_UNITS, THERMAL_ERRORS

_COLOURS = {
    "none": "#cbd5e1",
    "hold": "#9aa5b1",
    "regression": "#111111",
    "pso, static": "#93c5fd",
    "pso, adaptive": "#1f6feb",
    "tck, static": "#fdba74",
    "tck, adaptive": "#c2410c",
    "search, static": "#86efac",
    "search, adaptive": "#15803d",
    "learner, adaptive": "#7c3aed",
}
_COURSE = ("without compensation", "left", "limit")
_COMPARED = ("EX0C", "EZ0A", "EB0C")
"""Errors whose residuals with static and adaptive inputs are drawn above each other."""


def bars(rows: Rows) -> Figure:
    """Bars by error, one for each method."""
    methods = list(dict.fromkeys(row[1] for row in rows[1:]))
    made = figure(12, 4)
    ax = made.subplots()
    x, width = np.arange(len(THERMAL_ERRORS)), 0.8 / len(methods)
    for i, method in enumerate(methods):
        mean, reach = np.array([row[3:] for row in rows[1:] if row[1] == method], dtype=np.float64).T
        at = x + (i - len(methods) / 2 + 0.5) * width
        drawn = reach if reach.any() else None
        ax.bar(at, mean, width, yerr=drawn, color=_COLOURS[method], label=method, error_kw={"lw": 0.7})
    ax.set_xticks(x, [f"{e}\n{ERROR_UNITS[e]}" for e in THERMAL_ERRORS])
    ax.set_ylabel(rows[1][0])
    ax.legend(loc="upper right", fontsize=7.5, frameon=False, ncols=4)
    return made


def course_of(run: Run) -> Picture:
    """A limit stands where it begins."""
    drawn: Mapping[str, Any] = run.result["drawn"]
    truth, left, limits = (np.array(drawn[name], dtype=np.float64).T for name in ("truth", "left", "limits"))
    hours = np.arange(len(truth)) * drawn["step_h"]
    updated = np.zeros(len(hours), dtype=np.bool_)
    updated[np.searchsorted(hours, np.array(run.result["updates"]) / 12.0, side="right") - 1] = True
    before = np.vstack([np.full(limits.shape[1], np.nan), limits[:-1]])
    begins = ~((limits == before) | (np.isnan(limits) & np.isnan(before)))
    rows = [["hour", "update", *(f"{error} {what}" for what in _COURSE for error in THERMAL_ERRORS)]]
    for k, hour in enumerate(hours):
        values = [f"{v:.3g}" for v in (*truth[k], *left[k])]
        values += [f"{v:.3g}" if new else "" for v, new in zip(limits[k], begins[k], strict=True)]
        rows.append([f"{hour:g}", "1" if updated[k] else "", *values])
    return Picture(course, rows, "Every third step.")


def course(rows: Rows) -> Figure:
    """A panel per error: without compensation, what is left, limits, and the hours of model updates."""
    cells = columns(rows)
    hours = np.array(cells["hour"], dtype=np.float64)
    made = figure(12, 15)
    axes = made.subplots(len(THERMAL_ERRORS), 1, sharex=True)
    for ax, error in zip(axes, THERMAL_ERRORS, strict=True):
        truth, left = (np.array(cells[f"{error} {what}"], dtype=np.float64) for what in _COURSE[:2])
        limit = _last_known(cells[f"{error} {_COURSE[2]}"])
        ax.plot(hours, truth, color="#9aa5b1", lw=0.8, label="without compensation")
        ax.plot(hours, left, color="#c2410c", lw=0.6, label="left")
        for sign in (1, -1):
            ax.step(hours, sign * limit, where="post", color="#b08900", lw=0.8, label="ACL" if sign > 0 else None)
        for hour, update in zip(hours, cells["update"], strict=True):
            if update:
                ax.axvline(float(hour), color="#16a34a", lw=0.6, ls="--")
        for border in borders(float(hours[-1])):
            ax.axvline(border, color="#111111", lw=1.0)
        ax.set_ylabel(f"{error}, {ERROR_UNITS[error]}", fontsize=8)
    axes[0].legend(loc="upper right", fontsize=7.5, frameon=False, ncols=3)
    axes[-1].set_xlabel(
        "hours (dashed green: model update; black: the next season begins, a day later on the controller's grid)"
    )
    return made


def _last_known(cells: Sequence[str]) -> FloatArray:
    """An empty cell has the value above it; NaN before the first."""
    values, last = np.empty(len(cells)), float("nan")
    for i, cell in enumerate(cells):
        values[i] = last = float(cell) if cell else last
    return values


def borders(until_h: float) -> list[float]:
    """Hours at which a season begins."""
    begins = np.cumsum(list(LONG_TERM_H.values()))[:-1]
    return [float(h) for h in begins if h < until_h]


def chosen_of(run: Run) -> Picture:
    sets: list[Mapping[str, Any]] = run.result["inputs"]
    rows = [["hour", *THERMAL_ERRORS]]
    rows += [[f"{m['after'] / 12:g}", *(" ".join(m.get(error, ())) for error in THERMAL_ERRORS)] for m in sets]
    caption = (
        "Inputs that each model update chose; the first column ends the calibration, lines are the seasons' borders."
    )
    return Picture(chosen, rows, caption)


def chosen(rows: Rows) -> Figure:
    """A row per input, a column per model update, a mark per error that uses it."""
    cells = columns(rows)
    sets = {error: [cell.split() for cell in cells[error]] for error in THERMAL_ERRORS}
    used = sorted({name for found in sets.values() for names in found for name in names})
    after_h = [float(hour) for hour in cells["hour"]]
    made = figure(12, 1.0 + 0.22 * len(used))
    ax = made.subplots()
    for e, error in enumerate(THERMAL_ERRORS):
        points = [(u + (e - 4) * 0.085, used.index(name)) for u, names in enumerate(sets[error]) for name in names]
        if points:
            ax.plot(*zip(*points, strict=True), "s", ms=3.5, color=f"C{e}", label=error)
    for border in borders(after_h[-1]):
        ax.axvline(sum(h < border for h in after_h) - 0.5, color="#111111", lw=1.0)
    ax.set_yticks(range(len(used)), used, fontsize=7)
    ax.set_ylim(len(used) - 0.5, -0.5)
    ax.set_xticks(range(len(after_h)), [f"{h:.0f} h" for h in after_h])
    ax.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=9, fontsize=7.5, frameon=False)
    return made


def against(static: Run, adaptive: Run) -> Picture:
    """What is left of some errors with inputs chosen once and again, within their limits."""
    ways = {"static": static.result["drawn"], "adaptive": adaptive.result["drawn"]}
    places = [THERMAL_ERRORS.index(error) for error in _COMPARED]
    rows = [["hour", *(f"{e} {way} {what}" for e in _COMPARED for way in ways for what in ("left", "limit"))]]
    series = [
        (drawn["left"][place], [None if v is None else f"{v:.3g}" for v in drawn["limits"][place]])
        for place in places
        for drawn in ways.values()
    ]
    for k in range(len(series[0][0])):
        cells = [f"{k * ways['static']['step_h']:g}"]
        for left, limit in series:
            new = k == 0 or limit[k] != limit[k - 1]
            cells += ["nan" if left[k] is None else f"{left[k]:.3g}", (limit[k] or "nan") if new else ""]
        rows.append(cells)
    return Picture(residuals, rows, "Lines: the limits, the largest residual of each training. Every third step.")


def limits_of(run: Run, error: int) -> tuple[float, float]:
    """Least and largest limit of an error (its place) in a run that is drawn."""
    known = [v for v in run.result["drawn"]["limits"][error] if v is not None]
    return min(known), max(known)


def residuals(rows: Rows) -> Figure:
    """A panel per error and way."""
    cells = columns(rows)
    hours = np.array(cells["hour"], dtype=np.float64)
    made = figure(12, 7)
    axes = made.subplots(len(_COMPARED), 2, sharex=True, sharey="row")
    for line, error in zip(axes, _COMPARED, strict=True):
        for ax, (way, colour) in zip(line, (("static", "#93c5fd"), ("adaptive", "#1f6feb")), strict=True):
            ax.plot(hours, np.array(cells[f"{error} {way} left"], dtype=np.float64), color=colour, lw=0.7)
            limit = _last_known(cells[f"{error} {way} limit"])
            for sign in (1, -1):
                ax.step(hours, sign * limit, where="post", color="#b08900", lw=0.9)
            for border in borders(float(hours[-1])):
                ax.axvline(border, color="#111111", lw=1.0)
            ax.set_title(f"{error}, {way} inputs", fontsize=9)
        line[0].set_ylabel(f"left, {ERROR_UNITS[error]}")
    for ax in axes[-1]:
        ax.set_xlabel("hours (black: the next season begins)")
    return made
