"""The key space and the payloads under it: one place that says what is published where, and how it reads.

Keys are `<prefix>/<machine>/<kind>[/<name>]`. Payloads are JSON objects in UTF-8; a number that does not exist is null.
Readers must ignore fields they do not know.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from drivers.base import Reading
from gateway.nc.slew import Write
from gateway.probing.cycle import Outcome
from gateway.probing.schedule import Outlook
from talc.frame import Decision, Event, FloatArray, Frame
from talc.models import ErrorModel
from talc.names import THERMAL_ERRORS
from talc.sensor_check import Judgement

READING: Final = "reading"
FRAME: Final = "frame"
DECISION: Final = "decision"
MEASUREMENT: Final = "measurement"
MODEL: Final = "model"
EVENT: Final = "event"
COMPENSATION: Final = "compensation"
PROBING: Final = "probing"
SENSORS: Final = "sensors"
STATUS: Final = "status"
ALIVE: Final = "alive"

Payload = dict[str, Any]


def root(prefix: str, machine: str) -> str:
    """The key that all of a gateway's keys begin with."""
    return f"{prefix}/{machine}"


def encode(payload: Mapping[str, Any]) -> bytes:
    """JSON without NaN. ValueError: a number that is not finite was not replaced."""
    return json.dumps(payload, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()


def decode(data: bytes) -> Payload:
    """The object of a payload. ValueError: not a JSON object."""
    found = json.loads(data)
    if not isinstance(found, dict):
        raise ValueError(f"payload {data[:40]!r}: expected a JSON object")  # noqa: TRY004 - what the sender wrote
    return found


def reading(r: Reading, now_s: float) -> Payload:
    """`reading/<channel>`: `age_s` is how long ago `source_time` was, at monotonic `now_s`, whatever UTC does."""
    return {
        "channel": r.channel,
        "value": _number(r.value),
        "unit": r.unit,
        "quality": r.quality.value,
        "source_time": r.source_time.isoformat(),
        "age_s": round(max(0.0, now_s - r.monotonic_s), 3),
        "sequence": r.sequence,
        "detail": r.detail,
    }


def frame(f: Frame, input_names: Sequence[str]) -> Payload:
    """`frame`: inputs by name; null where there was no good value."""
    values = {n: _number(v) if ok else None for n, v, ok in zip(input_names, f.inputs, f.valid, strict=True)}
    measured = None if f.measurement is None else _by_error(f.measurement.errors)
    return {"k": f.k, "inputs": values, "measured": measured}


def decision(d: Decision) -> Payload:
    """`decision`: nine errors by name, µm and µm/m."""
    return {
        "k": d.k,
        "phase": d.phase.value,
        "predicted": _by_error(d.predicted),
        "corrected": _by_error(d.corrected),
        "sigma": _by_error(d.sigma),
        "limits": _by_error(d.limits),
        "measure": None if d.measure is None else d.measure.value,
        "training": None if d.training is None else d.training.why.value,
        "substituted": list(d.substituted),
    }


def measurement(o: Outcome) -> Payload:
    """`measurement`: one probing cycle; without errors when it was refused, failed or rejected, and why."""
    m = o.measurement
    return {
        "number": o.number,
        "why": o.why.value,
        "asked": o.asked.isoformat(),
        "ended": o.ended.isoformat(),
        "errors": None if m is None else _by_error(m.errors),
        "sigma": None if m is None else _by_error(m.sigma),
        "residual_um": _number(o.residual_um),
        "in_force_um": np.asarray(o.in_force_um).tolist(),
        "reason": o.reason,
    }


def model(m: ErrorModel, after_k: int) -> Payload:
    """`model/<error>`: what predicts this error from the step after `after_k` on."""
    return {
        "error": m.error,
        "after_k": after_k,
        "inputs": list(m.inputs),
        "poles": [abs(complex(p)) for p in m.poles()],
        "static_gain": [float(g) for g in m.static_gain()],
        "limit": m.limit,
        "residual_std": m.residual_std,
        "criterion": m.criterion,
    }


def event(e: Event, k: int | None) -> Payload:
    """`event`"""
    return {
        "k": k,
        "kind": e.kind.value,
        "text": e.text,
        "error": e.error,
        "value": None if e.value is None else _number(e.value),
        "limit": None if e.limit is None else _number(e.limit),
    }


def compensation(w: Write) -> Payload:
    """`compensation`: one step; X, Y, Z in µm."""
    return {
        "k": w.k,
        "mode": w.mode,
        "source": w.step.source.value,
        "target_um": list(w.step.target_um),
        "offsets_um": list(w.step.offsets_um),
        "coefficients_um": [list(row) for row in w.step.coefficients_um],
        "bounded": list(w.step.bounded),
        "positions": dict(w.positions),
        "written": w.written,
        "read_back_um": None if w.read_back_um is None else list(w.read_back_um),
    }


def probing(o: Outlook) -> Payload:
    """`probing`: where the wish for a measurement stands, since when this was published, and why."""
    return {
        "standing": o.standing.value,
        "why": None if o.why is None else o.why.value,
        "reason": o.reason,
        "rejected": o.rejected,
        "operator": o.operator,
    }


def sensors(j: Judgement, k: int) -> Payload:
    """`sensors`: what does not agree with the other sensors; what the last window would have shown, and what not."""
    findings = [
        {
            "kind": f.kind,
            "inputs": list(f.inputs),
            "alternatives": list(f.alternatives),
            "offset_K": _number(f.offset_K),
            "score": _number(f.score),
            "text": f.text(),
        }
        for f in j.findings
    ]
    smallest = {name: _number(value) for name, value in j.smallest_offset_K.items()}
    return {"k": k, "findings": findings, "smallest_offset_K": smallest, "alike": [list(pair) for pair in j.alike]}


def status(
    phase: str | None,
    k: int | None,
    readings_dropped: int,
    periods_missed: Mapping[str, int],
    config: str | None,
    outlook: Outlook | None,
) -> Payload:
    """`status`: the latest decision, the fingerprint of the configuration that really runs, how probing stands.

    Null before each. periods_missed: by bus
    """
    return {
        "phase": phase,
        "k": k,
        "readings_dropped": readings_dropped,
        "periods_missed": dict(periods_missed),
        "config": config,
        "probing": None if outlook is None else probing(outlook),
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _by_error(values: FloatArray) -> dict[str, float | None]:
    return {name: _number(float(v)) for name, v in zip(THERMAL_ERRORS, values, strict=True)}
