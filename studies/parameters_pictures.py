"""Pictures of the study parameters: the paper's figures, with the policies and the regression."""

import numpy as np

from studies.page import Picture, figure, style, svg
from studies.parameters_points import FRONTS, TARGET_UM, ByCase, fewest_for

PAPER = {"A": (4.46, 96.42), "B": (4.62, 96.17), "C": (4.91, 95.87), "D": (5.29, 96.29)}
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


def over(fixed: ByCase, axis: str, name: str, label: str, below: str) -> Picture:
    """Means and bands of a figure over one parameter."""
    with style():
        made = figure(9, 4)
        ax = made.subplots()
        for case, points in fixed.items():
            at = sorted({p[axis] for p in points})
            groups = [np.array([p[name] for p in points if p[axis] == x]) for x in at]
            ax.plot(at, [g.mean() for g in groups], ".-", color=_COLOURS[case], label=f"load case {case}")
            low, high = ([np.percentile(g, q) for g in groups] for q in (10, 90))
            ax.fill_between(at, low, high, color=_COLOURS[case], alpha=0.1, lw=0)
        ax.set_xlabel(below)
        ax.set_ylabel(label)
        ax.legend(loc="upper right", fontsize=8, frameon=False)
        return Picture(svg(made), "Mean over all other parameters; bands from the 10th to the 90th percentile.")


def front(cases: list[str], fronts: dict[str, ByCase]) -> Picture:
    """P99 over Pd."""
    with style():
        made = figure(11, 8.5)
        axes = made.subplots((len(cases) + 1) // 2, min(2, len(cases)), squeeze=False, sharex=True, sharey=True)
        for ax, case in zip(axes.flat, cases, strict=False):
            for kind, colour in _GROUPS.items():
                pairs = [(p["Pd"], p["P99"]) for p in fronts[kind][case]]
                if pairs:
                    size = 1.5 if kind == "fixed" else 2.5
                    ax.plot(*zip(*pairs, strict=True), ".", ms=size, color=colour, label=FRONTS[kind])
            best = fewest_for(fronts["fixed"][case], TARGET_UM)
            if best is not None:
                ax.plot(best["Pd"], best["P99"], "o", ms=7, mfc="none", color="#111111", label="best below 5 µm")
            ax.plot(PAPER[case][1], PAPER[case][0], "*", ms=9, color="#b91c1c", label="the paper's best common set")
            ax.axhline(TARGET_UM, color="#b91c1c", lw=0.8, ls="--")
            ax.set_title(f"load case {case}", fontsize=9)
            ax.set_ylim(0, 20)
        axes[0][0].legend(loc="upper right", fontsize=7.5, frameon=False)
        for row in axes:
            row[0].set_ylabel("P99, µm")
        for ax in axes[-1]:
            ax.set_xlabel("productivity Pd, %")
        return Picture(svg(made), "Every set of parameters; P99 above 20 µm is not shown.")
