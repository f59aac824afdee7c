"""Pictures of the study parameters: the paper's figures, with the policies and the regression."""

import numpy as np
from matplotlib.figure import Figure

from studies.page import Picture, Rows, figure
from studies.parameters_points import FRONTS, TARGET_UM, ByCase, fewest_for
from studies.printed import B19_TABLE_3

PAPER = {case: values[3:] for case, values in B19_TABLE_3.items()}
"""The paper's P99, µm, and Pd, %, of its best common set on its four load cases."""
_COLOURS = {"A": "#1f6feb", "B": "#16a34a", "C": "#c2410c", "D": "#7c3aed"}
_GROUPS = {
    "fixed": "#9aa5b1",
    "adaptive": "#c2410c",
    "sparse_fixed": "#16a34a",
    "sparse_adaptive": "#1f6feb",
    "regression": "#111111",
    "sparse_regression": "#b08900",
    "learner": "#7c3aed",
}
_BEST = "best"
"""Kind of the set with the fewest measurements below the target."""
_HIGHEST_UM = 20.0


def over(fixed: ByCase, axis: str, name: str, label: str, below: str) -> Picture:
    """Means and bands of a figure over one parameter."""
    rows = [["load case", below, label, "10th percentile", "90th percentile"]]
    for case, points in fixed.items():
        for x in sorted({p[axis] for p in points}):
            group = np.array([p[name] for p in points if p[axis] == x])
            line = (group.mean(), *np.percentile(group, (10, 90)))
            rows.append([case, f"{x:g}", *(f"{v:.4g}" for v in line)])
    return Picture(bands, rows, "Mean over all other parameters; bands from the 10th to the 90th percentile.")


def bands(rows: Rows) -> Figure:
    """A curve with its band per load case."""
    made = figure(9, 4)
    ax = made.subplots()
    for case in dict.fromkeys(row[0] for row in rows[1:]):
        at, mean, low, high = np.array([row[1:] for row in rows[1:] if row[0] == case], dtype=np.float64).T
        ax.plot(at, mean, ".-", color=_COLOURS[case], label=f"load case {case}")
        ax.fill_between(at, low, high, color=_COLOURS[case], alpha=0.1, lw=0)
    ax.set_xlabel(rows[0][1])
    ax.set_ylabel(rows[0][2])
    ax.legend(loc="upper right", fontsize=8, frameon=False)
    return made


def front(cases: list[str], fronts: dict[str, ByCase]) -> Picture:
    """P99 over Pd, rounded to what can be seen."""
    rows = [["load case", "kind", "Pd, %", "P99, µm"]]
    for case in cases:
        found = [(kind, p) for kind in _GROUPS for p in fronts[kind][case]]
        if (best := fewest_for(fronts["fixed"][case], TARGET_UM)) is not None:
            found.append((_BEST, best))
        shown = [[case, kind, f"{p['Pd']:.2f}", f"{p['P99']:.1f}"] for kind, p in found if p["P99"] <= _HIGHEST_UM]
        rows += [list(row) for row in dict.fromkeys(map(tuple, shown))]
    return Picture(dots, rows, "Every set of parameters; P99 above 20 µm is not shown.")


def dots(rows: Rows) -> Figure:
    """A panel per load case, a dot per set of parameters."""
    cases = list(dict.fromkeys(row[0] for row in rows[1:]))
    made = figure(11, 8.5)
    axes = made.subplots((len(cases) + 1) // 2, min(2, len(cases)), squeeze=False, sharex=True, sharey=True)
    for ax, case in zip(axes.flat, cases, strict=False):
        points = {
            kind: np.array([row[2:] for row in rows[1:] if row[:2] == [case, kind]], dtype=np.float64)
            for kind in (*_GROUPS, _BEST)
        }
        for kind, colour in _GROUPS.items():
            if len(points[kind]):
                size = 1.5 if kind == "fixed" else 2.5
                ax.plot(*points[kind].T, ".", ms=size, color=colour, label=FRONTS[kind])
        if len(points[_BEST]):
            ax.plot(*points[_BEST].T, "o", ms=7, mfc="none", color="#111111", label="best below 5 µm")
        ax.plot(PAPER[case][1], PAPER[case][0], "*", ms=9, color="#b91c1c", label="the paper's best common set")
        ax.axhline(TARGET_UM, color="#b91c1c", lw=0.8, ls="--")
        ax.set_title(f"load case {case}", fontsize=9)
        ax.set_ylim(0, _HIGHEST_UM)
    made.legend(
        *axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3, markerscale=2, frameon=False
    )
    for row in axes:
        row[0].set_ylabel("P99, µm")
    for ax in axes[-1]:
        ax.set_xlabel("productivity Pd, %")
    return made
