"""Pictures of the study published-grid: what each parameter changes, Pd against P99, and the errors day by day."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from studies.page import Picture, Rows, figure
from studies.parameters_points import TARGET_UM, StudyPoint
from studies.printed import B19_TABLE_3
from talc.frame import FloatArray

AXES = {
    "calibration_h": "calibration, h",
    "interval_h": "interval, h",
    "ng_interval_min": "no-good interval, min",
    "ng_count": "no-good measurements",
}
_SHOWN = {"SMAPE": "SMAPE, %", "RMSE": "RMSE, µm", "P99": "P99, µm", "Pd": "Pd, %"}
_COLOURS = {"A": "#1f6feb", "B": "#16a34a", "C": "#c2410c", "D": "#7c3aed"}
_HIGHEST_UM = 30.0
_PAPER = "the paper's common set"
_COMMON = "the same set here"
Points = Mapping[str, Sequence[StudyPoint]]
"""Of settings that measure after the calibration, by load case."""


def effects(points: Points) -> Picture:
    """Medians of every indicator along every parameter."""
    rows = [["load case", "parameter", "value", "indicator", "median", "10th percentile", "90th percentile"]]
    for case, own in points.items():
        for axis, title in AXES.items():
            for x in sorted({p[axis] for p in own}):
                for name, label in _SHOWN.items():
                    low, middle, high = np.percentile([p[name] for p in own if p[axis] == x], (10, 50, 90))
                    rows.append([case, title, f"{x:g}", label, *(f"{v:.4g}" for v in (middle, low, high))])
    return Picture(panels, rows, "Median over all other parameters; bands from the 10th to the 90th percentile.")


def panels(rows: Rows) -> Figure:
    """A column per parameter, a row per indicator, a curve with its band per load case."""
    made = figure(12, 9)
    axes = made.subplots(len(_SHOWN), len(AXES), sharex="col", sharey="row")
    for i, label in enumerate(_SHOWN.values()):
        for j, title in enumerate(AXES.values()):
            ax = axes[i, j]
            for case, colour in _COLOURS.items():
                own = [row for row in rows[1:] if (row[0], row[1], row[3]) == (case, title, label)]
                if own:
                    x, middle, low, high = np.array([(row[2], *row[4:]) for row in own], dtype=np.float64).T
                    ax.plot(x, middle, ".-", color=colour, label=case)
                    ax.fill_between(x, low, high, color=colour, alpha=0.08, lw=0)
            if label.startswith("P99"):
                ax.axhline(TARGET_UM, color="#b91c1c", lw=0.8, ls="--")
            if j == 0:
                ax.set_ylabel(label)
            if i == len(_SHOWN) - 1:
                ax.set_xlabel(title)
    axes[0, 0].legend(title="load case", fontsize=8, frameon=False, ncols=2)
    return made


def trade(points: Points, common: Mapping[str, StudyPoint]) -> Picture:
    """P99 over Pd of every setting, rounded to what can be seen."""
    rows = [["load case", "kind", "Pd, %", "P99, µm"]]
    for case, own in points.items():
        shown = [[f"{p['Pd']:.1f}", f"{p['P99']:.1f}"] for p in own if p["P99"] <= _HIGHEST_UM]
        rows += [[case, "", *at] for at in dict.fromkeys(map(tuple, shown))]
        if case in common:
            rows.append([case, _COMMON, f"{common[case]['Pd']:.2f}", f"{common[case]['P99']:.2f}"])
        rows.append([case, _PAPER, f"{B19_TABLE_3[case][4]:g}", f"{B19_TABLE_3[case][3]:g}"])
    return Picture(cloud, rows, f"Every setting; P99 above {_HIGHEST_UM:g} µm is not shown.")


def cloud(rows: Rows) -> Figure:
    """A panel per load case, a dot per setting."""
    made = figure(12, 3.4)
    axes = made.subplots(1, len(_COLOURS), sharey=True)
    for ax, (case, colour) in zip(axes, _COLOURS.items(), strict=True):
        for kind, mark in (
            ("", {"ms": 2.0, "marker": "."}),
            (_COMMON, {"marker": "o", "mfc": "none"}),
            (_PAPER, {"marker": "*", "ms": 9}),
        ):
            at: FloatArray = np.array([row[2:] for row in rows[1:] if row[:2] == [case, kind]], dtype=np.float64)
            if len(at):
                own = "#b91c1c" if kind == _PAPER else "#111111" if kind else colour
                ax.plot(*at.T, ls="", color=own, label=kind or None, **mark)
        ax.axhline(TARGET_UM, color="#b91c1c", lw=0.8, ls="--")
        ax.set_title(f"load case {case}", fontsize=9)
        ax.set_xlabel("productivity Pd, %")
    axes[0].set_ylabel("P99, µm")
    axes[-1].legend(loc="upper left", fontsize=7.5, frameon=False)
    return made


def over_time(updated: Points) -> Picture:
    """RMSE of each day of the common set, by update interval."""
    rows = [["load case", "update interval, h", "day", "RMSE, µm"]]
    for case, own in updated.items():
        for p in own:
            rows += [[case, f"{p['update_h']:g}", str(day), f"{v:.4g}"] for day, v in enumerate(p["daily"], 1)]
    return Picture(
        by_day,
        rows,
        "The common set, 24 h at a time after the calibration. Grey: models also updated each 8 to 96 h; black: only "
        "after a residual beyond its limit.",
    )


def by_day(rows: Rows) -> Figure:
    """A panel per load case, a curve per update interval; the longest is over when the load case is."""
    made = figure(12, 3.4)
    axes = made.subplots(1, len(_COLOURS), sharey=True)
    for ax, case in zip(axes, _COLOURS, strict=True):
        own = [row for row in rows[1:] if row[0] == case]
        intervals = sorted({float(row[1]) for row in own})
        for update_h in intervals:
            at: FloatArray = np.array([row[2:] for row in own if float(row[1]) == update_h], dtype=np.float64)
            last = update_h == intervals[-1]
            ax.plot(*at.T, ".-", color="#111111" if last else "#9aa5b1", lw=1.4 if last else 0.7)
        ax.set_title(f"load case {case}", fontsize=9)
        ax.set_xlabel("day after the calibration")
    axes[0].set_ylabel("RMSE, µm")
    axes[0].set_ylim(bottom=0)
    return made
