"""The report's figures as inline SVG."""

import io
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from gateway.report.data import ReportData
from talc.frame import Phase
from talc.models import ModelSet
from talc.names import ERROR_MEANINGS, ERROR_UNITS, THERMAL_ERRORS

_HOUR = 3600.0
_SHADE = {Phase.CALIBRATION: "#f4ecd2", Phase.NO_GOOD: "#f6d9d5"}
_TRUTH, _PREDICTION, _MEASURED, _RESIDUAL, _LIMIT = "#9aa5b1", "#1f6feb", "#111111", "#c2410c", "#b08900"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "path",
    "svg.hashsalt": "talc-gateway",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "grid.linewidth": 0.6,
}


def error_plot(data: ReportData, e: int) -> str:
    """Error, estimate and measurements above; the residual with the limits below. SVG."""
    name, unit = data.labels[e], ERROR_UNITS[THERMAL_ERRORS[e]]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1.2])
        hours = data.time_s / _HOUR
        _shade(top, data)
        _shade(bottom, data)
        if data.truth is not None:
            top.plot(data.truth.time_s / _HOUR, data.truth.errors[:, e], color=_TRUTH, lw=2.5, label="simulated truth")
        top.plot(hours, data.corrected[:, e], color=_PREDICTION, lw=1.1, label="estimate in force")
        if data.recorded is not None:
            top.plot(hours, data.recorded[:, e], ".", color=_TRUTH, ms=2.5, label="recorded")
        seen = np.isfinite(data.measured[:, e])
        label = "measured" if data.recorded is None else "used as a measurement"
        top.plot(hours[seen], data.measured[seen, e], ".", color=_MEASURED, ms=2.5, label=label)
        top.set_ylabel(f"{name}, {unit}")
        top.set_title(
            f"{name}: {ERROR_MEANINGS[name]}" if name in ERROR_MEANINGS else name,
            loc="left",
            fontsize=10,
            fontweight="bold",
        )
        if data.truth is not None:
            index = np.clip(np.searchsorted(data.time_s, data.truth.time_s, side="right") - 1, 0, None)
            left = data.truth.errors[:, e] - data.corrected[index, e]
            bottom.plot(data.truth.time_s / _HOUR, left, color=_RESIDUAL, lw=0.9, label="truth minus estimate")
        seen_as, known = ("measured", data.measured) if data.recorded is None else ("recorded", data.recorded)
        residual = known[:, e] - data.predicted[:, e]
        bottom.plot(hours, residual, ".", color=_MEASURED, ms=2.5, label=f"{seen_as} minus predicted")
        for sign in (1, -1):
            bottom.step(
                hours, sign * data.limits[:, e], where="post", color=_LIMIT, lw=1.0, label="ACL" if sign > 0 else None
            )
        for adopted in data.models:
            at = (adopted.after_k - data.k[0]) * data.step_s / _HOUR
            bottom.axvline(at, color="#16a34a", lw=0.9, ls="--")
        bottom.set_ylabel(f"left, {unit}")
        bottom.set_xlabel("hours since the first frame (dashed green: model update)")
        bottom.set_xlim(0, hours[-1] if hours[-1] > 0 else 1)
        for axes in (top, bottom):
            axes.legend(loc="upper left", ncols=4, fontsize=7.5, frameon=False)
        return _svg(figure)


def inputs_plot(data: ReportData) -> str:
    """Which inputs each model used, over the model updates. SVG; empty text without models."""
    used = [n for n in data.input_names if any(n in _inputs(a.models, e) for a in data.models for e in range(9))]
    if not used:
        return ""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 0.9 + 0.24 * len(used)), layout="constrained")
        axes = figure.subplots()
        axes.grid(visible=False)
        marks = mpl.colormaps["tab10"].colors  # type: ignore[attr-defined]
        for u, adopted in enumerate(data.models):
            for e, name in enumerate(data.labels):
                rows = [used.index(i) for i in _inputs(adopted.models, e)]
                x = [u + (e - 4) * 0.085] * len(rows)
                axes.plot(x, rows, "s", ms=5, color=marks[e], label=name if u == 0 else None)
        for u in range(len(data.models) - 1):
            axes.axvline(u + 0.5, color="#e5e7eb", lw=0.8)
        for row in range(len(used)):
            axes.axhline(row, color="#f1f5f9", lw=0.8, zorder=0)
        axes.set_yticks(range(len(used)), used)
        axes.set_ylim(len(used) - 0.5, -0.5)
        at = [(a.after_k - data.k[0]) * data.step_s / _HOUR for a in data.models]
        axes.set_xticks(range(len(at)), [f"{t:.0f} h" for t in at])
        axes.set_xlim(-0.6, len(at) - 0.4)
        axes.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=9, fontsize=7.5, frameon=False)
        return _svg(figure)


def tool_plot(data: ReportData) -> str:
    """Offsets on the control and, where known, the remaining deviation at the tool. SVG."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 5.4), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for i, (axes, axis) in enumerate(zip(panels, "XYZ", strict=True)):
            _shade(axes, data)
            if data.truth is not None:
                cutting = ~data.truth.probing
                t = data.truth.time_s[cutting] / _HOUR
                axes.plot(
                    t, data.truth.uncompensated_um[cutting, i], ".", ms=1.2, color=_TRUTH, label="without compensation"
                )
                axes.plot(
                    t, data.truth.compensated_um[cutting, i], ".", ms=1.2, color=_RESIDUAL, label="with compensation"
                )
            else:
                axes.step(
                    data.compensation_s / _HOUR, data.compensation_um[:, i], where="post", color=_PREDICTION, lw=0.8
                )
            axes.set_ylabel(f"{axis}, µm")
        if data.truth is not None:
            panels[0].legend(loc="upper left", ncols=2, fontsize=7.5, frameon=False, markerscale=6)
        panels[-1].set_xlabel("hours since the first frame")
        panels[-1].set_xlim(0, max(float(data.time_s[-1]) / _HOUR, 1e-3))
        return _svg(figure)


def picture(data: ReportData) -> bytes:
    """Of a simulation: how far the tool is from where it should be, along Z, and how far without the gateway. PNG.

    ValueError: the truth is not known.
    """
    if data.truth is None:
        raise ValueError("the picture is of a simulation, whose truth is known")
    cutting = ~data.truth.probing & (data.truth.time_s <= data.time_s[-1] + data.step_s)  # afterwards nothing runs
    hours = data.truth.time_s[cutting] / _HOUR
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9, 3), layout="constrained")
        axes = figure.subplots()
        for values, colour, label in (
            (data.truth.uncompensated_um, _TRUTH, "without compensation"),
            (data.truth.compensated_um, _RESIDUAL, "with compensation"),
        ):
            axes.plot(hours, values[cutting, 2], color=colour, lw=0.9, label=label)
        measured = np.isfinite(data.measured).any(axis=1)
        at = data.time_s[measured] / _HOUR
        axes.plot(at, np.zeros(at.size), "|", color=_MEASURED, ms=9, label=f"{at.size} measurements")
        axes.set_ylabel("tool to workpiece, Z, µm")
        axes.set_xlabel("hours")
        axes.set_xlim(0, float(hours[-1]))
        axes.legend(loc="upper left", ncols=3, fontsize=8, frameon=False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
        return buffer.getvalue()


def _inputs(models: ModelSet, e: int) -> tuple[str, ...]:
    model = models.models[e]
    return () if model is None else tuple(model.inputs)


def _shade(axes: Axes, data: ReportData) -> None:
    """Calibration and no-good phases."""
    hours, begin = data.time_s / _HOUR, 0
    for i in range(1, len(data.phases) + 1):
        if i == len(data.phases) or data.phases[i] is not data.phases[begin]:
            colour = _SHADE.get(data.phases[begin])
            if colour is not None:
                axes.axvspan(hours[begin], hours[min(i, len(hours) - 1)], color=colour, lw=0, zorder=0)
            begin = i


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = buffer.getvalue()
    return text[text.index("<svg") :]
