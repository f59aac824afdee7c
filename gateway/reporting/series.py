"""The charts as data for the page's script."""

import json
import math

from gateway.reporting.charts import Chart, ChartGroup, spans, update_times
from gateway.reporting.data import ReportData
from gateway.reporting.local import shifts_between
from talc.frame import FloatArray

_MOST_POINTS = 1000
_MOST_SHIFT_LINES = 60


def series(data: ReportData, groups: list[ChartGroup]) -> str:
    """JSON that may stand in a page: times in whole seconds since `start` (UTC; without dates since the first row)."""
    last = float(data.time_s[-1])
    edges = [begin for begin, _ in shifts_between(data.start_utc_s, data.start_utc_s + last, data.shifts, data.zone)]
    whole = {
        "start": data.start_utc_s - (data.origin_s or 0.0),
        "dated": data.origin_s is None,
        "end": max(last, data.step_s),
        "zone": getattr(data.zone, "key", "UTC") if data.origin_s is None else "UTC",
        "spans": [[round(s.begin_s), round(s.end_s), s.phase.value] for s in spans(data)],
        "updates": [round(at) for at in update_times(data)],
        "shifts": [round(at - data.start_utc_s) for at in edges[1:]] if len(edges) <= _MOST_SHIFT_LINES else [],
        "groups": {group.key: [_chart(chart) for chart in group.charts] for group in groups},
    }
    return json.dumps(whole, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("<", "\\u003c")


def _chart(chart: Chart) -> dict[str, object]:
    lines = [line.thinned(_MOST_POINTS) for line in chart.lines]
    return {
        "title": chart.title,
        "unit": chart.unit,
        "low": chart.low,
        "lines": [
            {
                "label": line.label,
                "ink": line.ink,
                "kind": line.kind,
                "x": [round(t) for t in line.time_s.tolist()],
                "y": _rounded(line.values),
            }
            for line in lines
        ],
    }


def _rounded(values: FloatArray) -> list[float | None]:
    """To four digits: more cannot be seen."""
    return [float(f"{v:.4g}") if math.isfinite(v) else None for v in values.tolist()]
