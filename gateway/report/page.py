"""The HTML page: one file, nothing loaded from elsewhere."""

from datetime import UTC, datetime
from importlib.resources import files

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from gateway.report.data import ReportData
from gateway.report.figures import summary
from gateway.report.plots import error_plot, inputs_plot, tool_plot
from talc.frame import EventKind
from talc.names import THERMAL_ERRORS

_SENSORS = (EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE)
_GOOD = ("good", "simulated")


def build(data: ReportData) -> str:
    """The page of a run."""
    template = files("gateway.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    unhealthy = [
        (name, ", ".join(f"{quality}: {count}" for quality, count in sorted(counts.items())))
        for name, counts in data.channel_health.items()
        if any(quality not in _GOOD for quality in counts)
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
        events=[(at / 3600.0, event) for at, event in data.events if event.kind is not EventKind.STATE_UPDATE],
    )


def _known(data: ReportData, e: int) -> bool:
    """Whether a recording holds this error at all; a run has all nine."""
    return data.recorded is None or bool(np.isfinite(data.recorded[:, e]).any())


def _date(utc_s: float) -> str:
    return f"{datetime.fromtimestamp(utc_s, UTC):%Y-%m-%d %H:%M}"
