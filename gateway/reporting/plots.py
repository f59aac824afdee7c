"""The report's charts as pictures: inline SVG whose text is text, for paper and for readers without a script."""

import io
import re
from datetime import UTC, datetime
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from gateway.model.text import Language
from gateway.reporting.charts import Chart, ChartGroup, Ink, inputs_of_model, spans, update_times
from gateway.reporting.data import ReportData
from talc.frame import FloatArray, Phase

_DAY = 86400.0
_HOUR = 3600.0
INK_COLOURS = {
    Ink.BEFORE: "#8b97a5",
    Ink.AFTER: "#c2410c",
    Ink.ESTIMATE: "#1f6feb",
    Ink.MEASURED: "#111112",
    Ink.LIMIT: "#b08900",
    Ink.T0: "#1b6ac9",
    Ink.T1: "#d9480f",
    Ink.T2: "#2b8a3e",
    Ink.T3: "#9c36b5",
    Ink.T4: "#0c8599",
    Ink.T5: "#a9760a",
    Ink.T6: "#c2255c",
    Ink.T7: "#5c6670",
}
_INK = "#1f2933"
_GRID = "#e2e8f0"
_UPDATE = "#16a34a"
_SHADE = {Phase.CALIBRATION: "#f4ecd2", Phase.NO_GOOD: "#f6d9d5"}
_VARIABLES = {
    **{colour: f"var(--{ink})" for ink, colour in INK_COLOURS.items()},
    **{colour: f"var(--{phase})" for phase, colour in _SHADE.items()},
    _INK: "var(--ink)",
    _GRID: "var(--line)",
    _UPDATE: "var(--update)",
}
"""The page's own colours, which follow the reader's light or dark."""
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_NAME = re.compile(r"""(\bid="|url\(#|href="#)""")
_MOST_POINTS = 700
_MOST_DOTS = 250
CHART_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "talc-gateway",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.6,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), _INK),
}


def still(data: ReportData, group: ChartGroup) -> str:
    """A group's charts below each other on one axis of local time, or of hours. SVG."""
    with mpl.rc_context(CHART_STYLE):
        heights = [1.2 if chart.low else 2.0 for chart in group.charts]
        tall = sum(heights) + 0.35 * len(heights) + 0.4
        figure = Figure(figsize=(10, tall))  # margins by hand: a layout engine would draw everything twice
        panels = figure.subplots(len(group.charts), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        figure.subplots_adjust(left=0.075, right=0.99, top=1 - 0.3 / tall, bottom=0.45 / tall, hspace=0.3)
        for axes, chart in zip(panels, group.charts, strict=True):
            draw_chart(axes, data, chart)
        show_time(panels[-1], data)
        return _svg(figure, group.key)


def show_time(axes: Axes, data: ReportData, *, named: bool = True) -> None:
    """The run's whole time across a chart. named: with times below it"""
    last = float(data.time_s[-1])
    axes.set_xlim(*across(data, np.array([0.0, last if last > 0 else data.step_s])))
    if data.origin_s is None:
        locator = AutoDateLocator(tz=data.zone)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        dates = ConciseDateFormatter(locator, tz=data.zone)  # type: ignore[no-untyped-call]
        for formats in (dates.formats, dates.zero_formats, dates.offset_formats):
            formats[:] = [each.replace("%b", "%m") for each in formats]  # as the texts write dates, in any language
        axes.xaxis.set_major_formatter(dates)
    else:
        axes.xaxis.set_major_formatter("{x:g} h")
    if not named:
        axes.tick_params(labelbottom=False)
        axes.xaxis.get_offset_text().set_visible(False)


def draw_chart(axes: Axes, data: ReportData, chart: Chart, *, legend: bool = True) -> None:
    """A chart's lines, shaded spans and model updates."""
    for span in spans(data):
        begin, end = across(data, np.array([span.begin_s, span.end_s]))
        axes.axvspan(begin, end, color=_SHADE[span.phase], lw=0, zorder=0)
    for line in chart.lines:
        shown, colour = line.thinned(_MOST_DOTS if line.kind == "dots" else _MOST_POINTS), INK_COLOURS[line.ink]
        at = across(data, shown.time_s)
        if line.kind == "dots":
            axes.plot(at, shown.values, ".", color=colour, ms=3.5, label=line.label)
        else:
            style = "steps-post" if line.kind == "step" else "default"
            axes.plot(at, shown.values, color=colour, lw=1.1, drawstyle=style, label=line.label)
    for at_s in update_times(data):
        axes.axvline(float(across(data, np.array([at_s]))[0]), color=_UPDATE, lw=0.9, ls="--")
    axes.set_ylabel(f"{chart.title}, {chart.unit}" if chart.unit else chart.title)
    if legend:
        axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=7.5, frameon=False, borderaxespad=0.1
        )


def across(data: ReportData, seconds: FloatArray) -> FloatArray:
    """matplotlib's dates: days since 1970, UTC; of a recording without dates hours since its first row."""
    if data.origin_s is not None:
        return np.asarray((data.start_utc_s - data.origin_s + seconds) / _HOUR, dtype=np.float64)
    return np.asarray((data.start_utc_s + seconds) / _DAY, dtype=np.float64)


def _below(data: ReportData, seconds: float) -> str:
    """A moment as the text below a tick."""
    if data.origin_s is not None:
        return data.moment(seconds)
    return f"{datetime.fromtimestamp(data.start_utc_s + seconds, UTC).astimezone(data.zone):%d %b\n%H:%M}"


def inputs_plot(data: ReportData) -> str:
    """Which inputs each model used, over the model updates. SVG; empty text without models."""
    used = [
        n for n in data.input_names if any(n in inputs_of_model(a.models, e) for a in data.models for e in range(9))
    ]
    if not used:
        return ""
    with mpl.rc_context(CHART_STYLE):
        figure = Figure(figsize=(10, 0.9 + 0.24 * len(used)), layout="constrained")
        axes = figure.subplots()
        axes.grid(visible=False)
        marks = mpl.colormaps["tab10"].colors  # type: ignore[attr-defined]
        for u, adopted in enumerate(data.models):
            for e, name in enumerate(data.labels):
                rows = [used.index(i) for i in inputs_of_model(adopted.models, e)]
                x = [u + (e - 4) * 0.085] * len(rows)
                axes.plot(x, rows, "s", ms=5, color=marks[e], label=name if u == 0 else None)
        for u in range(len(data.models) - 1):
            axes.axvline(u + 0.5, color=_GRID, lw=0.8)
        for row in range(len(used)):
            axes.axhline(row, color=_GRID, lw=0.8, zorder=0)
        axes.set_yticks(range(len(used)), used)
        axes.set_ylim(len(used) - 0.5, -0.5)
        times = [_below(data, at) for at in update_times(data)]
        axes.set_xticks(range(len(times)), times)
        axes.set_xlim(-0.6, len(times) - 0.4)
        axes.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=9, fontsize=7.5, frameon=False)
        return _svg(figure, "chosen")


def picture(data: ReportData) -> bytes:
    """A simulation's picture: how far the tool is from where it should be, along Z, and how far without the gateway.

    PNG. ValueError: the truth is not known.
    """
    if data.truth is None:
        raise ValueError("the picture is of a simulation, whose truth is known")
    cutting = ~data.truth.probing & data.truth_ran
    hours, said = data.truth.time_s[cutting] / 3600.0, Language(data.language)
    with mpl.rc_context(CHART_STYLE):
        figure = Figure(figsize=(9, 3), layout="constrained")
        axes = figure.subplots()
        for values, ink, key in (
            (data.truth.uncompensated_um, Ink.BEFORE, "without"),
            (data.truth.compensated_um, Ink.AFTER, "with"),
        ):
            axes.plot(hours, values[cutting, 2], color=INK_COLOURS[ink], lw=0.9, label=said(f"report_line.{key}"))
        measured = np.isfinite(data.measured).any(axis=1)
        at = data.time_s[measured] / 3600.0
        axes.plot(
            at,
            np.zeros(at.size),
            "|",
            color=INK_COLOURS[Ink.MEASURED],
            ms=9,
            label=said("report_line.measurements", n=at.size),
        )
        axes.set_ylabel(said("report_line.tool_z"))
        axes.set_xlabel(said("report_line.hours"))
        axes.set_xlim(0, float(hours[-1]))
        axes.legend(loc="upper left", ncols=3, fontsize=8, frameon=False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
        return buffer.getvalue()


def _svg(figure: Figure, key: str) -> str:
    """Without a background; in the page's colours; with names that no other picture of the page has."""
    figure.patch.set_visible(False)
    for axes in figure.axes:
        axes.patch.set_visible(False)
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = _METADATA.sub("", buffer.getvalue())
    text = _NAME.sub(lambda found: f"{found[1]}{key}-", text)
    text = _COLOUR.sub(lambda found: _VARIABLES.get(found[0], found[0]), text)
    return text[text.index("<svg") :]
