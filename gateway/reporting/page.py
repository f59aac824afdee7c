"""The HTML page: one file that loads nothing from elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from importlib.resources import files

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from gateway.model.text import Language, Value
from gateway.reporting.charts import ChartGroup, error_charts, input_charts, tool_charts
from gateway.reporting.coordinates import by_coordinate
from gateway.reporting.data import NotYet, ReportData
from gateway.reporting.figures import summary
from gateway.reporting.first_lines import by_shift, losses, not_good, tolerance_met, verdict
from gateway.reporting.local import hours, weekday
from gateway.reporting.no_values import no_values
from gateway.reporting.plots import inputs_plot, still
from gateway.reporting.series import series
from gateway.reporting.sketch import letters, sketch
from talc.explanation import ErrorReason
from talc.frame import EventKind, Phase
from talc.names import (
    ERROR_MEANINGS,
    ERROR_UNITS,
    LEAST_NAMED,
    LEAST_SHARE_NAMED,
    MOST_NAMED,
    THERMAL_ERRORS,
)

_SENSORS = (EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE)
_MOST_EVENTS = 2000


def _own_file(name: str) -> str:
    return files("gateway.reporting").joinpath(name).read_text(encoding="utf-8")


_PAGES = Environment(autoescape=True, undefined=StrictUndefined, loader=FunctionLoader(_own_file))


@dataclass(frozen=True, slots=True)
class _ShownGroup:
    """Charts of the page, and the notes on them."""

    key: str
    title: str
    still: Markup
    heading: str = ""
    letters: str = ""
    moved: str = ""
    sketch: str = ""


def build(data: ReportData) -> str:
    """The page of a run."""
    s, said = summary(data), Language(data.language)
    unhealthy = not_good(data, said)
    tool, (inputs, basis) = tool_charts(data, s.course), input_charts(data)
    errors = [(e, error_charts(data, e)) for e in range(len(THERMAL_ERRORS)) if _known(data, e)]
    groups = [group for group in (tool, inputs, *(group for _, group in errors)) if group is not None]
    told = [(data.moment(at), event) for at, event in data.events if event.kind is not EventKind.STATE_UPDATE]
    first = -data.step_s if data.recorded is None else 0.0  # a gateway's step ends at its instant
    return _page(
        "page.html",
        said,
        data=data,
        s=s,
        not_yet=[each.written(said) for each in data.not_yet],
        verdict=verdict(data, s),
        tolerance_met=tolerance_met(data, s),
        losses=losses(data, s),
        shifts=by_shift(data, s),
        coordinates=by_coordinate(data),
        begin=data.moment(first),
        end=data.moment(float(data.time_s[-1])),
        lasted=hours(s.hours * 3600.0, said),
        corrections=data.moment(s.begin_hours * 3600.0),
        zone=getattr(data.zone, "key", None) or str(data.zone),
        marks={
            "calibration": Phase.CALIBRATION in data.phases,
            "no_good": Phase.NO_GOOD in data.phases,
            "models": bool(data.models),
            "limits": bool(np.isfinite(data.limits).any()),
        },
        tool=_chart_group(data, tool),
        inputs=_chart_group(data, inputs),
        inputs_basis=basis,
        errors=[_error_group(data, e, group, said) for e, group in errors],
        chosen=Markup(inputs_plot(data)),
        unhealthy=unhealthy,
        healthy=len(data.channel_health) - len(unhealthy),
        no_values=no_values(data),
        suspects=[(data.moment(at), said.of(e.text)) for at, e in data.events if e.kind in _SENSORS],
        why=_why(data, said),
        events=[(at, said.word("event", e.kind.value), said.of(e.text)) for at, e in told[-_MOST_EVENTS:]],
        hidden=max(len(told) - _MOST_EVENTS, 0),
        series=Markup(series(data, groups)),
        library=Markup(f"/*\n{_own_file('uplot/LICENSE')}*/\n{_own_file('uplot/uPlot.iife.min.js')}"),
        script=Markup(_own_file("page.js")),
    )


def nothing_learnt(machine: str, missing: Sequence[NotYet], said: Language) -> str:
    """The page of a gateway that has not ended a grid step."""
    title, lead = said("report.nothing_learnt"), said("report.still_missing")
    return _nothing(machine, title, lead, [each.written(said) for each in missing], said)


def nothing_that_day(machine: str, day: date, begin: str, end: str, said: Language) -> str:
    """The page of a day of which no grid step is stored.

    begin, end: the first and the last time of which one is
    """
    title = said("report.nothing_that_day", day=f"{weekday(day, said)} {day}")
    missing = (NotYet("that_day", {"begin": begin, "end": end}), NotYet("off_that_day"))
    return _nothing(machine, title, said("report.to_do"), [each.written(said) for each in missing], said)


def _nothing(machine: str, title: str, lead: str, missing: Sequence[tuple[str, str]], said: Language) -> str:
    return _page("nothing.html", said, machine=machine, title=title, lead=lead, missing=missing)


def _page(template: str, said: Language, **values: object) -> str:
    def t(key: str, /, **inner: Value) -> str:
        return said(f"report.{key}", **inner)

    return _PAGES.get_template(template).render(values, said=said, t=t, n=said.number, styles=_styles())


def _styles() -> Markup:
    return Markup(_own_file("uplot/uPlot.min.css") + _own_file("page.css"))


def _chart_group(data: ReportData, group: ChartGroup | None) -> _ShownGroup | None:
    return None if group is None else _ShownGroup(group.key, group.title, Markup(still(data, group)))


def _error_group(data: ReportData, e: int, group: ChartGroup, said: Language) -> _ShownGroup:
    name = data.labels[e]
    return _ShownGroup(
        key=group.key,
        title=group.title,
        still=Markup(still(data, group)),
        heading=f"{name}: {said(f'error.{name}')}" if name in ERROR_MEANINGS else name,
        letters=letters(name, said),
        moved=_movers(data, e, said),
        sketch=Markup(sketch(name, said)),
    )


def _movers(data: ReportData, e: int, said: Language) -> str:
    """The inputs that moved an error most, on the mean of the stored reasons."""
    if data.moved is None:
        return ""
    largest = [int(i) for i in np.argsort(-data.moved[e], kind="stable")[:MOST_NAMED]]
    unit = ERROR_UNITS[THERMAL_ERRORS[e]]
    each = [(i, float(data.moved[e, i])) for i in largest if data.moved[e, i] >= LEAST_NAMED]
    return ", ".join(f"{data.input_names[i]} ({said.number(by, '.1f')} {unit})" for i, by in each)


@dataclass(frozen=True, slots=True)
class _WhyRow:
    """One error's row of reasons, as texts."""

    error: str
    corrected: str
    estimate: str
    inputs: str
    level: str
    experts: str
    expected: str


def _why(data: ReportData, said: Language) -> tuple[str, str, list[_WhyRow]]:
    """When, what is expected when, and a row for each error that was measured; none without a learner."""
    if data.reasons is None:
        return "", "", []
    r = data.reasons
    at, due = (data.moment((k - int(data.k[0])) * data.step_s) for k in (r.k, r.next_k))
    share = None if data.trusted is None else 100.0 * data.trusted.mean(axis=0)
    rows = []
    for e, reason in enumerate(r.errors):
        if np.isfinite(reason.estimate):
            trusted = said("report.trusted" if reason.trusted else "report.not_trusted")
            believed = ((said.word("expert", kind.replace(" ", "_")), part) for kind, part in reason.experts)
            rows.append(
                _WhyRow(
                    data.labels[e],
                    trusted if share is None else said("report.trusted_share", text=trusted, percent=float(share[e])),
                    f"{_signed(reason.estimate, said)} {ERROR_UNITS[reason.error]}",
                    _moved(reason, said),
                    _signed(reason.level, said),
                    ", ".join(f"{kind} {100.0 * part:.0f} %" for kind, part in believed if part >= LEAST_SHARE_NAMED),
                    f"{_signed(reason.expected, said)} ± {said.number(reason.expected_sigma, '.1f')}",
                )
            )
    return at, f"{due} ({said.word('why', r.next_why.value)})", rows


def _signed(value: float, said: Language) -> str:
    """With its sign, unless it is rounded to zero."""
    return said.number(value, "+.1f") if abs(value) >= LEAST_NAMED else said.number(0.0, ".1f")


def _moved(reason: ErrorReason, said: Language) -> str:
    told = [f"{name} {_signed(value, said)}" for name, value in reason.inputs if abs(value) >= LEAST_NAMED]
    others = said("report.others", um=_signed(reason.other_inputs, said))
    return ", ".join([*told, others]) if reason.trusted else ""


def _known(data: ReportData, e: int) -> bool:
    """Whether a recording contains this error at all; a run has all nine as soon as one has been measured."""
    if data.recorded is not None:
        return bool(np.isfinite(data.recorded[:, e]).any())
    return data.truth is not None or data.judged_from is not None or bool(np.isfinite(data.measured).any())
