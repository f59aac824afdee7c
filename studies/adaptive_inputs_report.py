"""Report of the study adaptive-inputs: Z22's Tables 3 and 4, errors over time, chosen inputs, bars with k = 2."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from simulators.cases import LONG_TERM_H
from studies.adaptive_inputs_cells import against_none, against_static, beside_paper
from studies.frame import Run
from studies.page import Claim, PageSection, Picture, Report, Rows, Table, TableRow, columns, figure, rounded_text
from studies.paired import paired
from studies.printed import CRITERION, Z22_TABLE_3, Z22_TEXT, counted
from talc.frame import FloatArray
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

WAYS = (
    *((selector, inputs) for selector in ("pso", "tck", "search") for inputs in ("static", "adaptive")),
    ("learner", "adaptive"),
)
TRANSLATIONAL = np.array([ERROR_UNITS[name] == MICROMETRE for name in THERMAL_ERRORS])
PAPER_MEAN_E_PV = {
    ("pso", "adaptive"): Z22_TEXT["mean E_PV of six, adaptive, µm"],
    ("tck", "adaptive"): Z22_TEXT["mean E_PV of six, TCK, µm"],
    ("pso", "static"): Z22_TEXT["mean E_PV of six, static, µm"],
}
_PAPER_UPDATES = {
    way: (Z22_TEXT[f"model updates, {way[1]}"], Z22_TEXT[f"deviation (k = 2) of model updates, {way[1]}"])
    for way in (("pso", "static"), ("pso", "adaptive"))
}
_PAPER_SMALL = ("EY0A", "EY0C")
"""Errors that did not improve in Z22."""
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
_ASKED = """Is it worth choosing a model's inputs again at every model update (adaptive), rather than once in the
calibration (static)? As in Z22 a machine runs 196 h, 72 h and 72 h in three seasons under a new random load of one
axis at a time each 5 min; a day of calibration, then a measurement each 2 h, and 16 in a row with a model update when
a residual exceeds its limit. Errors count from the start of the first season; each season begins with a measurement.

Three selectors choose: pso, Z22's Group-LASSO with a particle swarm over penalty and orders (to 5, least squares,
limits of its training); tck, the earlier sequential choice by the Time Series Cluster Kernel (ARX of order 1, least
squares, the same limits); search, the default of trained models (output error, judged on unseen rows). Each is repeated
with other sensor and probing noise and another seed on the same physics; the paper repeats the selection on the same
recording.
E_PV is largest minus smallest, E_RMS the root mean square about zero, of what is left against the simulated truth
after the first day, before a measurement of the same moment.

none: no compensation. hold: the last of the same measurements. regression: a linear regression on all inputs renewed
with the measurements that search (adaptive) made. learner: all inputs weighted again at each measurement, with one each
2 h and none for model updates."""

_NOT_ASKED = "not in it"
Pairing = tuple[str, str]


def report(runs: list[Run]) -> Report:
    """All selectors beside the paper's figures."""
    groups = {way: [r for r in runs if (r.parameters["selector"], r.parameters["inputs"]) == way] for way in WAYS}
    groups = {way: found for way, found in groups.items() if found}
    peak, rms, updates = _per_error(groups, "E_PV"), _per_error(groups, "E_RMS"), _updates(groups)
    over_time: list[PageSection] = []
    pictures: dict[Pairing, tuple[Picture, ...]] = {}
    for way, found in groups.items():
        drawn = next((r for r in found if "drawn" in r.result), None)
        if drawn is not None and way[1] == "adaptive":
            blocks = (_course(drawn), _chosen(drawn)) if drawn.result["inputs"] else (_course(drawn),)
            pictures[way] = blocks
            over_time.append(PageSection(f"Over time: {_name(way)}, first repetition", blocks))
    drawn_rows = [picture.rows for picture in pictures.get(("pso", "adaptive"), ())]
    beside = beside_paper(peak, rms, updates, *(drawn_rows if len(drawn_rows) == 2 else (None, None)))
    sections = (
        PageSection("E_PV (the paper's Table 3)", (peak, _bars(groups, "E_PV"))),
        PageSection("E_RMS (the paper's Table 3)", (rms, _bars(groups, "E_RMS"))),
        PageSection("Reduction against no compensation (the paper's Table 4)", (against_none(peak, rms),)),
        PageSection("Adaptive against static inputs, not a table of the paper's", (against_static(peak, rms),)),
        PageSection("Model updates and measurements", (updates,)),
        *over_time,
        PageSection("The paper, cell by cell", (f"{counted(beside)}. {CRITERION}", beside)),
    )
    return Report(_ASKED, _summary(groups), _claims(groups), sections, _figures(runs))


def _name(way: Pairing) -> str:
    return f"{way[0]}, {way[1]}"


def _values(runs: list[Run], what: str, name: str) -> FloatArray:
    """(runs, 9)"""
    return np.array([run.result[what][name] for run in runs], dtype=np.float64)


def _mean_pv(runs: list[Run], what: str = "models", name: str = "E_PV") -> FloatArray:
    """(runs,) mean over the translational errors, µm."""
    return np.asarray(_values(runs, what, name)[:, TRANSLATIONAL].mean(axis=1), dtype=np.float64)


def _spread(values: FloatArray) -> str:
    """Mean, and twice the standard deviation over the repetitions."""
    middle = float(values.mean())
    if np.ptp(values) <= 1e-9 * abs(middle):  # one run, or the same in all
        return rounded_text(middle)
    return f"{rounded_text(middle)} ± {rounded_text(2 * float(values.std(ddof=1)), 2)}"


def _regression(groups: Mapping[Pairing, list[Run]]) -> list[Run]:
    return [run for run in groups.get(("search", "adaptive"), []) if "regression" in run.result]


def _per_error(groups: Mapping[Pairing, list[Run]], name: str) -> Table:
    everyone = [run for found in groups.values() for run in found]
    lines = [("none", _values(everyone, "none", name)), ("hold", _values(everyone, "hold", name))]
    if plain := _regression(groups):
        lines.append(("regression", _values(plain, "regression", name)))
    lines += [(_name(way), _values(found, "models", name)) for way, found in groups.items()]
    rows = [
        TableRow((title, *(_spread(v) for v in values.T), _spread(values[:, TRANSLATIONAL].mean(axis=1))))
        for title, values in lines
    ]
    for title, place in (("paper: none", 0), ("paper: Group-LASSO, adaptive", 1)):
        theirs = [Z22_TABLE_3[name][error][place] for error in THERMAL_ERRORS]
        rows.append(TableRow((title, *(f"{v:g}" for v in theirs), "–"), paper=True))
    if name == "E_PV":
        blank = ["–"] * len(THERMAL_ERRORS)
        for way, title in (
            (("pso", "adaptive"), "adaptive"),
            (("pso", "static"), "static"),
            (("tck", "adaptive"), "TCK"),
        ):
            cells = (f"paper: {title}, 25 repetitions", *blank, f"{PAPER_MEAN_E_PV[way]:g}")
            rows.append(TableRow(cells, paper=True))
    head = (f"{name}, mean ± k = 2", *(f"{e}, {ERROR_UNITS[e]}" for e in THERMAL_ERRORS), "mean of six, µm")
    return Table(head, tuple(rows))


def _updates(groups: Mapping[Pairing, list[Run]]) -> Table:
    rows = []
    for way, found in groups.items():
        updates = np.array([len(run.result["updates"]) for run in found], dtype=np.float64)
        made = np.array([run.result["measurements"] for run in found], dtype=np.float64)
        rows.append(TableRow((_name(way), _spread(updates), _spread(made), str(len(found)))))
    for way, pair in _PAPER_UPDATES.items():
        rows.append(TableRow((f"paper: Group-LASSO, {way[1]}", "{} ± {}".format(*pair), "–", "25"), paper=True))
    return Table(("mean ± k = 2", "model updates", "measurements after calibration", "repetitions"), tuple(rows))


def _summary(groups: Mapping[Pairing, list[Run]]) -> Table:
    everyone = [run for found in groups.values() for run in found]
    lines = [("none", everyone, "none", "–", ""), ("hold", everyone, "hold", _NOT_ASKED, "")]
    if plain := _regression(groups):
        lines.append(("regression", plain, "regression", _NOT_ASKED, ""))
    rows = [
        TableRow((title, _spread(_mean_pv(found, what)), _spread(_mean_pv(found, what, "E_RMS")), paper, updates))
        for title, found, what, paper, updates in lines
    ]
    for way, found in groups.items():
        updates = _spread(np.array([len(run.result["updates"]) for run in found], dtype=np.float64))
        missing = _NOT_ASKED if way[0] in ("search", "learner") else "–"
        paper = f"{PAPER_MEAN_E_PV[way]:g}" if way in PAPER_MEAN_E_PV else missing
        figures = (_spread(_mean_pv(found)), _spread(_mean_pv(found, name="E_RMS")))
        rows.append(TableRow((_name(way), *figures, paper, updates)))
    head = ("mean of six translational errors, µm, ± k = 2", "E_PV", "E_RMS", "the paper's E_PV", "model updates")
    return Table(head, tuple(rows))


def _claims(groups: Mapping[Pairing, list[Run]]) -> tuple[Claim, ...]:
    mean = {way: float(_mean_pv(found).mean()) for way, found in groups.items()}
    found: list[Claim] = []
    for selector in ("pso", "tck", "search"):
        static, adaptive = (selector, "static"), (selector, "adaptive")
        if static in mean and adaptive in mean:
            pairs = paired(*_by_repetition(groups[static], groups[adaptive]))
            found.append(
                Claim(
                    f"Adaptive inputs leave less than static ones ({selector})",
                    "mean E_PV 10.6 against 12.6 µm (section 5)" if selector == "pso" else "not asked",
                    f"{mean[adaptive]:.1f} against {mean[static]:.1f} µm; by repetition {pairs} (k = 2)",
                    pairs.sure,
                    "A later season shows what the first day could not; but each new choice also rests on more noise.",
                )
            )
    if ("pso", "adaptive") in mean and ("tck", "adaptive") in mean:
        pairs = paired(*_by_repetition(groups["tck", "adaptive"], groups["pso", "adaptive"]))
        found.append(
            Claim(
                "The Group-LASSO leaves less than the Time Series Cluster Kernel",
                "mean E_PV 10.6 against 13.8 µm (section 5)",
                f"{mean['pso', 'adaptive']:.1f} against {mean['tck', 'adaptive']:.1f} µm; by repetition {pairs} "
                "(k = 2)",
                pairs.sure,
                "The kernel sees likeness of shape, not what an input adds; orders to 5 can also overfit a day.",
            )
        )
    if plain := _regression(groups):
        found += [_beside_regression(way, runs, plain) for way, runs in groups.items() if way[1] == "adaptive"]
    if ("pso", "adaptive") in groups:
        runs = groups["pso", "adaptive"]
        updates = np.array([len(run.result["updates"]) for run in runs], dtype=np.float64)
        found.append(
            Claim(
                "About 13 model updates in 340 h",
                "13.0 ± 3.5 (section 5)",
                _spread(updates),
                abs(float(updates.mean()) - _PAPER_UPDATES["pso", "adaptive"][0])
                <= _PAPER_UPDATES["pso", "adaptive"][1],
                "Limits from the training's own rows are narrow; how often they are exceeded depends on the machine.",
            )
        )
    found += [_small_errors(way, runs) for way, runs in groups.items() if way[1] == "adaptive"]
    return tuple(found)


def _by_repetition(
    *groups: list[Run], what: Sequence[str] = ("models", "models"), name: str = "E_PV"
) -> list[FloatArray]:
    """Mean of the translational errors, µm, of two groups in the order of their common repetitions.

    All ways have the same noise in a repetition, so they can be compared in pairs.
    """
    by = [{run.parameters["repetition"]: run for run in runs} for runs in groups]
    common = sorted(set(by[0]) & set(by[1]))
    return [_mean_pv([runs[r] for r in common], w, name) for runs, w in zip(by, what, strict=True)]


def _beside_regression(way: Pairing, runs: list[Run], plain: list[Run]) -> Claim:
    peak, rms = (
        paired(*_by_repetition(plain, runs, what=("regression", "models"), name=name)) for name in ("E_PV", "E_RMS")
    )
    own, other = float(_mean_pv(runs).mean()), float(_mean_pv(plain, "regression").mean())
    return Claim(
        f"Models leave less than a regression on all inputs ({_name(way)})",
        "not asked",
        f"mean E_PV {own:.2f} against {other:.2f} µm; by repetition {peak} (k = 2); E_RMS {rms}",
        peak.sure and rms.sure,
        "The regression uses all inputs and renews its gains at each measurement (those of search, adaptive); "
        + (
            "so does the learner, which also knows lags and how far to trust them."
            if way[0] == "learner"
            else "the models keep few inputs, remember, and are renewed at their updates only."
        ),
    )


def _small_errors(way: Pairing, runs: list[Run]) -> Claim:
    before, after = _values(runs, "none", "E_PV"), _values(runs, "models", "E_PV")
    kept = [e for e, a, b in zip(THERMAL_ERRORS, after.T, before.T, strict=True) if not paired(b, a).sure]
    return Claim(
        f"EY0A and EY0C do not improve ({way[0]})",
        "E_PV 22.3 and 8.3 % more (Table 3), 3 to -1 and 3 to 0 % less (Table 4)",
        "E_PV not surely less than uncompensated (k = 2): " + (", ".join(kept) or "none"),
        set(_PAPER_SMALL) <= set(kept),
        "An error of the size of the probing noise cannot be learned from measurements with that noise; which errors "
        "are so small depends on the machine.",
    )


def _bars(groups: Mapping[Pairing, list[Run]], name: str) -> Picture:
    everyone = [run for found in groups.values() for run in found]
    series = {method: _values(everyone, method, name) for method in ("none", "hold")}
    if plain := _regression(groups):
        series["regression"] = _values(plain, "regression", name)
    series |= {_name(way): _values(found, "models", name) for way, found in groups.items()}
    rows = [["figure", "method", "error", "mean", "k = 2"]]
    for method, values in series.items():
        reach = 2 * values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(THERMAL_ERRORS))
        lines = zip(THERMAL_ERRORS, values.mean(axis=0), reach, strict=True)
        rows += [[name, method, error, f"{mean:.4g}", f"{about:.3g}"] for error, mean, about in lines]
    return Picture(bars, rows, "Mean over the repetitions; error bars: twice the standard deviation (k = 2).")


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


def _course(run: Run) -> Picture:
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


def _chosen(run: Run) -> Picture:
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


def _figures(runs: list[Run]) -> list[list[object]]:
    rows: list[list[object]] = [
        ["seed", "repetition", "selector", "inputs", "updates", "measurements", "what", "figure", *THERMAL_ERRORS]
    ]
    for run in runs:
        p, counts = run.parameters, [len(run.result["updates"]), run.result["measurements"]]
        for what in ("none", "hold", "regression", "models"):
            for name in ("E_PV", "E_RMS"):
                if what in run.result:
                    own = [p["seed"], p["repetition"], p["selector"], p["inputs"], *counts, what, name]
                    rows.append([*own, *run.result[what][name]])
    return rows
