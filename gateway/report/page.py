"""The HTML page: one file that loads nothing from elsewhere."""

from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from drivers.base import Quality
from gateway.report.data import ReportData
from gateway.report.figures import summary
from gateway.report.plots import error_plot, inputs_plot, tool_plot
from talc.frame import EventKind
from talc.learner import ErrorReason
from talc.names import ERROR_UNITS, THERMAL_ERRORS

_SENSORS = (EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE)
_LEAST_SHOWN = 0.05
"""µm or µm/m: what moves an error by less is not named."""
_LEAST_SHARE = 0.05


def build(data: ReportData) -> str:
    """The page of a run."""
    template = files("gateway.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    unhealthy = [
        (name, ", ".join(f"{quality}: {count}" for quality, count in sorted(counts.items())))
        for name, counts in data.channel_health.items()
        if any(quality != Quality.GOOD for quality in counts)
    ]
    return environment.from_string(template).render(
        data=data,
        s=summary(data),
        begin=_date(data.start_utc_s),
        end=_date(data.start_utc_s + float(data.time_s[-1])),
        errors=[Markup(error_plot(data, e)) for e in range(len(THERMAL_ERRORS)) if _known(data, e)],
        inputs=Markup(inputs_plot(data)),
        tool=Markup(tool_plot(data) if data.recorded is None else ""),
        unhealthy=unhealthy,
        healthy=len(data.channel_health) - len(unhealthy),
        suspects=[(at / 3600.0, e.text) for at, e in data.events if e.kind in _SENSORS],
        why=_why(data),
        events=[(at / 3600.0, event) for at, event in data.events if event.kind is not EventKind.STATE_UPDATE],
    )


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


def _why(data: ReportData) -> tuple[str, str, list[_WhyRow]]:
    """When, what is expected when, and a row for each error that was measured; none without a learner."""
    if data.reasons is None:
        return "", "", []
    r = data.reasons
    at, due = _date(r.k * data.step_s), _date(r.next_k * data.step_s)
    share = None if data.trusted is None else data.trusted.mean(axis=0)
    rows = [
        _WhyRow(
            data.labels[e],
            ("yes" if reason.trusted else "no: no estimate is better than none")
            + ("" if share is None else f"; {share[e]:.0%} of the steps"),
            f"{reason.estimate:+.1f} {ERROR_UNITS[reason.error]}",
            _moved(reason),
            f"{reason.level:+.1f}",
            ", ".join(f"{kind} {part:.0%}" for kind, part in reason.experts if part >= _LEAST_SHARE),
            f"{reason.expected:+.1f} ± {reason.expected_sigma:.1f}",
        )
        for e, reason in enumerate(r.errors)
        if np.isfinite(reason.estimate)
    ]
    return at, f"{due} ({r.next_why.value.replace('_', ' ')})", rows


def _moved(reason: ErrorReason) -> str:
    told = [f"{name} {value:+.1f}" for name, value in reason.inputs if abs(value) >= _LEAST_SHOWN]
    return ", ".join([*told, f"others {reason.other_inputs:+.1f}"]) if reason.trusted else ""


def _known(data: ReportData, e: int) -> bool:
    """Whether a recording contains this error at all; a run has all nine."""
    return data.recorded is None or bool(np.isfinite(data.recorded[:, e]).any())


def _date(utc_s: float) -> str:
    return f"{datetime.fromtimestamp(utc_s, UTC):%Y-%m-%d %H:%M}"
