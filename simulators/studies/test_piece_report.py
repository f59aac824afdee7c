"""Report of the study test-piece: how far features drift over the hours, by method, with and without growth."""

import numpy as np

from simulators.studies.frame import Run
from simulators.studies.page import Claim, Picture, Report, Row, Section, Table, figure, number, style, svg
from talc.frame import FloatArray

METHODS = ("none", "hold", "regression", "TALC")
_ALL = tuple(f"{method}{term}" for method in METHODS for term in ("", " + growth"))
_ASKED = """How much of a machine's warming does a part show, and how much of it does the control take away? A test
piece is milled hour by hour: 4 h with the C axis at 1200 1/min, then 4 h at rest, a set of six features at the begin
and after each hour (B19, section 4). Before it the control had a day of calibration under changing C speeds and
cutting fluid, and the machine a night of rest; a measurement each 2 h went on throughout.

A feature's deviation is that of the tool against the workpiece in the direction that the feature shows, in the
correction's state before a measurement of the same moment, against the first set. The workpiece is aluminium; its mean
temperature follows table and working space (30 min and 2 h), and what is milled on a warm workpiece is smaller when it
has cooled. The growth term corrects for it with the temperature of the table's sensor, as the workpiece has none.

none: no compensation. hold: the last of the same measurements. regression: a linear regression on all inputs, renewed
with each of the same measurements. TALC: the default settings."""


def report(runs: list[Run]) -> Report:
    """Ranges over the nine sets, and every feature over the hours."""
    features: list[str] = runs[0].result["features"]
    ranges = {name: np.array([np.ptp(run.result[name], axis=0) for run in runs]) for name in _ALL}
    median = {name: np.median(values, axis=0) for name, values in ranges.items()}
    mean = {name: float(np.mean(values)) for name, values in median.items()}
    head = ("range over the sets, µm, median", *features, "mean")
    rows = tuple(Row((n, *(number(v, 2) for v in median[n]), number(mean[n], 2))) for n in _ALL)
    best = min(("hold", "regression"), key=lambda m: mean[f"{m} + growth"])
    losses = [f for f, a, b in zip(features, median["TALC + growth"], median["none"], strict=True) if a >= b]
    worse = [f for f, a, b in zip(features, median["TALC + growth"], median[f"{best} + growth"], strict=True) if a >= b]
    claims = (
        Claim(
            "Compensation lessens the drift of the features",
            "yes; its figures are not at hand",
            f"mean range {mean['none']:.1f} to {mean['TALC']:.1f} µm"
            + (f"; not of {', '.join(losses)}" if losses else "; of every feature"),
            mean["TALC"] < mean["none"],
            "The C drive warms what lies between table and bed within hours, and the calibration has seen such loads.",
        ),
        Claim(
            "What is left is largely the workpiece's own growth (the paper's outlook)",
            "expected",
            f"mean range {mean['TALC']:.1f} to {mean['TALC + growth']:.1f} µm with the growth term",
            mean["TALC + growth"] < mean["TALC"],
            "The table's sensor is warmer than the workpiece while both warm up: the term overshoots at first.",
        ),
        Claim(
            "A learned model does better than the same measurements used plainly",
            "not asked",
            f"{best} with growth {mean[f'{best} + growth']:.1f} µm, TALC with growth {mean['TALC + growth']:.1f} µm"
            + (f"; {best} is better in {', '.join(worse)}" if worse else ""),
            mean["TALC + growth"] < mean[f"{best} + growth"],
            "A held measurement is up to 2 h old when a feature is milled; a regression lacks only memory.",
        ),
    )
    made = [int(run.result["measurements"]) for run in runs]
    swing = [float(run.result["workpiece_K"]) for run in runs]
    notes = (
        f"{len(runs)} repetitions with other weather, calibration loads and noise. During the test "
        f"{np.median(made):.0f} measurements (median; {min(made)} to {max(made)}); the workpiece warmed by "
        f"{np.median(swing):.1f} K."
    )
    sections = (
        Section("Every feature", (notes, Table(head, rows), _picture(runs))),
        Section("Largest deviation of any feature", (_largest(runs),)),
    )
    short = Table(("mean range of six features, µm", "without growth", "with growth"), _short(mean))
    return Report(_ASKED, short, claims, sections, _figures(runs))


def _short(mean: dict[str, float]) -> tuple[Row, ...]:
    return tuple(Row((m, number(mean[m], 3), number(mean[f"{m} + growth"], 3))) for m in METHODS)


def _largest(runs: list[Run]) -> Table:
    rows = []
    for name in _ALL:
        largest = np.array([np.abs(run.result[name]).max() for run in runs])
        rows.append(Row((name, number(float(np.median(largest)), 3), number(float(largest.max()), 3))))
    return Table(("|deviation| from the first set, µm", "median over the repetitions", "worst"), tuple(rows))


def _figures(runs: list[Run]) -> list[list[object]]:
    rows: list[list[object]] = [["seed", "repetition", "method", "hour", *runs[0].result["features"]]]
    for run in runs:
        for name in _ALL:
            for hour, line in enumerate(run.result[name]):
                rows.append([run.parameters["seed"], run.parameters["repetition"], name, hour, *map(repr, line)])
    return rows


def _picture(runs: list[Run]) -> Picture:
    shown = {"none": "#9aa5b1", "hold": "#b08900", "TALC": "#1f6feb", "TALC + growth": "#c2410c"}
    with style():
        made = figure(12, 6.5)
        axes = made.subplots(2, 3, sharex=True, squeeze=False)
        for i, feature in enumerate(runs[0].result["features"]):
            ax = axes[i // 3][i % 3]
            for name, colour in shown.items():
                lines: FloatArray = np.array([np.array(run.result[name])[:, i] for run in runs])
                hours = np.arange(lines.shape[1])
                ax.plot(hours, np.median(lines, axis=0), ".-", color=colour, lw=1.2, label=name)
                ax.fill_between(hours, lines.min(axis=0), lines.max(axis=0), color=colour, alpha=0.12, lw=0)
            ax.axvline(4, color="#cbd5e1", lw=0.8, ls="--")
            ax.set_title(feature, fontsize=9)
        axes[0][0].legend(fontsize=7.5, frameon=False)
        for row in axes:
            row[0].set_ylabel("µm")
        for ax in axes[1]:
            ax.set_xlabel("hours (dashed: the axis stops)")
        return Picture(svg(made), "Medians over the repetitions; bands from the least to the largest.")
