"""Contents of the charts: lines over one time axis, for the pictures and for the script alike."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from gateway.model.text import Language
from gateway.reporting.data import ReportData
from gateway.reporting.tool import ToolCourse
from talc.frame import FloatArray, Phase
from talc.models import ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

_ALIKE = 0.1
"""Share of the largest line of a chart: a smaller line has its own axis."""
_MOST_INPUTS = 8
"""Lines in a chart of inputs that can be told apart."""
_LONGEST_TITLE = 34
"""Characters beside a chart: of its inputs' names."""
_LONGEST_NAME = 23
"""Characters beside a chart: of one name."""
DEGREES = "degC"


class Ink(StrEnum):
    """Colours by their role; page.css gives their values, in the light and in the dark."""

    BEFORE = "before"
    AFTER = "after"
    ESTIMATE = "estimate"
    MEASURED = "measured"
    LIMIT = "limit"
    T0 = "t0"
    T1 = "t1"
    T2 = "t2"
    T3 = "t3"
    T4 = "t4"
    T5 = "t5"
    T6 = "t6"
    T7 = "t7"


_INPUT_INKS = (Ink.T0, Ink.T1, Ink.T2, Ink.T3, Ink.T4, Ink.T5, Ink.T6, Ink.T7)


@dataclass(frozen=True, slots=True, eq=False)
class ChartLine:
    """One line, of (m,) points."""

    label: str
    ink: Ink
    kind: Literal["line", "step", "dots"]
    time_s: FloatArray
    """Since the first frame."""
    values: FloatArray

    def thinned(self, most: int) -> "ChartLine":
        """At most about this many points: of each stretch of time the lowest and the highest, and the gaps."""
        if len(self.values) <= most:
            return self
        keep: list[int] = []
        for part in np.array_split(np.arange(len(self.values)), max(most // 2, 1)):
            known = part[np.isfinite(self.values[part])]
            if known.size:
                keep += sorted({int(known[np.argmin(self.values[known])]), int(known[np.argmax(self.values[known])])})
            else:
                keep.append(int(part[0]))
        return ChartLine(self.label, self.ink, self.kind, self.time_s[keep], self.values[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Lines with one vertical axis."""

    title: str
    unit: str
    lines: tuple[ChartLine, ...]
    low: bool = False
    """Whether little height is enough."""


@dataclass(frozen=True, slots=True, eq=False)
class ChartGroup:
    """Charts below each other, under one heading."""

    key: str
    title: str
    charts: tuple[Chart, ...]


@dataclass(frozen=True, slots=True)
class ChartSpan:
    """A time that is shaded in every chart."""

    begin_s: float
    end_s: float
    phase: Phase


def spans(data: ReportData) -> tuple[ChartSpan, ...]:
    """Calibration and no-good phases."""
    found, begin = [], 0
    for i in range(1, len(data.phases) + 1):
        if i == len(data.phases) or data.phases[i] is not data.phases[begin]:
            if data.phases[begin] in (Phase.CALIBRATION, Phase.NO_GOOD):
                end = data.time_s[min(i, len(data.phases) - 1)]
                found.append(ChartSpan(float(data.time_s[begin]), float(end), data.phases[begin]))
            begin = i
    return tuple(found)


def update_times(data: ReportData) -> list[float]:
    """Times of the model updates, seconds since the first frame."""
    return [float((adopted.after_k - data.k[0]) * data.step_s) for adopted in data.models]


def tool_charts(data: ReportData, course: ToolCourse | None) -> ChartGroup | None:
    """Offsets, and the deviation at the tool without and with them, of each axis; None of a recording."""
    if data.recorded is not None or (course is None and not data.compensation_s.size):
        return None
    charts, offsets, said = [], data.compensation_um, Language(data.language)
    for i, axis in enumerate("XYZ"):
        lines = [ChartLine(said("report_line.offset"), Ink.ESTIMATE, "step", data.compensation_s, offsets[:, i])]
        if course is not None:
            kind: Literal["line", "dots"] = "line" if data.truth is not None else "dots"
            lines += [
                ChartLine(said("report_line.without"), Ink.BEFORE, kind, course.time_s, course.before[:, i]),
                ChartLine(said("report_line.left"), Ink.AFTER, kind, course.time_s, course.after[:, i]),
            ]
        charts.append(Chart(axis, MICROMETRE, tuple(lines)))
    return ChartGroup("tool", said("report_line.tool"), tuple(charts))


def error_charts(data: ReportData, e: int) -> ChartGroup:
    """One thermal error: its course and the estimate; and what was left, with the action control limits."""
    name, unit, times = data.labels[e], ERROR_UNITS[THERMAL_ERRORS[e]], data.time_s
    seen, said = np.isfinite(data.measured[:, e]), Language(data.language)
    top, bottom = [], []
    if data.truth is not None:
        truth = data.truth
        index = np.maximum(data.rows_at(truth.time_s), 0)
        top.append(ChartLine(said("report_line.truth"), Ink.BEFORE, "line", truth.time_s, truth.errors[:, e]))
        left = truth.errors[:, e] - data.corrected[index, e]
        bottom.append(ChartLine(said("report_line.truth_left"), Ink.AFTER, "line", truth.time_s, left))
    if data.recorded is not None:
        top.append(ChartLine(said("report_line.recorded"), Ink.BEFORE, "dots", times, data.recorded[:, e]))
    top.append(ChartLine(said("report_line.estimate"), Ink.ESTIMATE, "line", times, data.corrected[:, e]))
    used = "measured" if data.recorded is None else "used"
    top.append(ChartLine(said(f"report_line.{used}"), Ink.MEASURED, "dots", times[seen], data.measured[seen, e]))
    key, known = ("measured_left", data.measured) if data.recorded is None else ("recorded_left", data.recorded)
    residual = known[:, e] - data.predicted[:, e]
    found = np.isfinite(residual)
    bottom.append(ChartLine(said(f"report_line.{key}"), Ink.MEASURED, "dots", times[found], residual[found]))
    if np.isfinite(data.limits[:, e]).any():
        bottom += [
            ChartLine(said("report_line.limit", sign=sign), Ink.LIMIT, "step", times, factor * data.limits[:, e])
            for sign, factor in (("+", 1.0), ("−", -1.0))
        ]
    return ChartGroup(
        name, name, (Chart(name, unit, tuple(top)), Chart(said("report_line.left"), unit, tuple(bottom), low=True))
    )


def input_charts(data: ReportData) -> tuple[ChartGroup | None, str]:
    """The temperatures, and other inputs by unit, that mattered most; and how that was found."""
    if data.inputs is None or not data.inputs.size:
        return None, ""
    (weight, basis), said = _weights(data), Language(data.language)
    units = data.input_units or ("",) * len(data.input_names)
    charts = []
    for unit in sorted(set(units), key=lambda u: u != DEGREES):
        own = [i for i, u in enumerate(units) if u == unit and np.isfinite(data.inputs[:, i]).any()]
        largest = sorted(own, key=lambda i: -weight[i])[:_MOST_INPUTS]
        chosen = [i for i in largest if unit == DEGREES or weight[i] > 0.0]
        lines = [
            ChartLine(data.input_names[i], ink, "line", data.time_s, data.inputs[:, i])
            for i, ink in zip(chosen, _INPUT_INKS, strict=False)
        ]
        if unit == DEGREES and lines:
            charts.append(Chart(said("report_line.temperatures"), "°C", tuple(lines)))
        else:
            charts += [Chart(_named(alike, said), unit, alike) for alike in _of_like_size(lines)]
    found = ChartGroup("inputs", said("report_line.inputs"), tuple(charts)) if charts else None
    return found, said(f"report_shown.{basis}")


def _named(lines: Sequence[ChartLine], said: Language) -> str:
    """The lines' names, as many as fit beside a chart; its legend has them all."""
    names = [n if len(n) <= _LONGEST_NAME else n[: _LONGEST_NAME - 1] + "…" for n in (line.label for line in lines)]
    for fit in range(len(names), 1, -1):
        title = ", ".join(names[:fit])
        if fit < len(names):
            title = said("report_line.more", names=title, n=len(names) - fit)
        if len(title) <= _LONGEST_TITLE:
            return title
    return said("report_line.more", names=names[0], n=len(names) - 1) if len(names) > 1 else names[0]


def _of_like_size(lines: Sequence[ChartLine]) -> Iterator[tuple[ChartLine, ...]]:
    """Lines that can share an axis: beside a speed whose unit is unknown, temperatures would be flat."""
    rest = {line: float(np.nanmax(np.abs(line.values))) for line in lines}
    while rest:
        least = _ALIKE * max(rest.values())
        alike = [line for line, size in rest.items() if size >= least]
        yield tuple(alike)
        rest = {line: size for line, size in rest.items() if line not in alike}


def _weights(data: ReportData) -> tuple[FloatArray, str]:
    """(n,) how much each input matters, and by what that is judged, a key of `report_shown`."""
    if data.moved is not None and data.moved.any():
        largest = np.maximum(data.moved.max(axis=1, keepdims=True), 1e-12)
        return (data.moved / largest).max(axis=0), "moved"
    chosen = {n for a in data.models for e in range(len(THERMAL_ERRORS)) for n in inputs_of_model(a.models, e)}
    if chosen:
        return np.array([float(name in chosen) for name in data.input_names]), "chosen"
    inputs = np.empty((0, len(data.input_names))) if data.inputs is None else data.inputs
    changes = [float(np.ptp(known)) if (known := of[np.isfinite(of)]).size else 0.0 for of in inputs.T]
    return np.array(changes), "changed"


def inputs_of_model(models: ModelSet, e: int) -> tuple[str, ...]:
    """Inputs of the model of one error."""
    model = models.models[e]
    return () if model is None else tuple(model.inputs)
