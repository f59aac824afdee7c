"""The tables of a database as people read them: one value a column, with names and units."""

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Final, Literal

from gateway.model.commands import CommandOutcome
from gateway.model.text import json_of
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredRun, StoredStep
from talc.explanation import Reasons
from talc.frame import Event
from talc.names import ERROR_UNITS, THERMAL_ERRORS

CellKind = Literal["time", "text", "number", "whole"]
CellKinds = Mapping[str, CellKind]
"""Name to kind, in order. Times are UTC; a number that is not known is empty."""
Cells = Sequence[object]

_UNITS = {name: unit.replace("µ", "u").replace("/", "_per_") for name, unit in ERROR_UNITS.items()}
_NO_ERRORS: Final = (None,) * len(THERMAL_ERRORS)


def _nine(prefix: str) -> dict[str, CellKind]:
    return {f"{prefix}_{name}_{_UNITS[name]}": "number" for name in THERMAL_ERRORS}


READINGS: Final[CellKinds] = {
    "time": "time", "channel": "text", "value": "number", "unit": "text", "quality": "text", "detail": "text",
    "run": "whole", "sequence": "whole",
}  # fmt: skip
MINUTES: Final[CellKinds] = {
    "time": "time", "channel": "text", "unit": "text", "count": "whole", "mean": "number", "low": "number",
    "high": "number",
}  # fmt: skip
MEASUREMENTS: Final[CellKinds] = {
    "number": "whole", "ended": "time", "why": "text", **_nine("measured"), "rejected_because": "text",
}  # fmt: skip
EVENTS: Final[CellKinds] = {
    "time": "time", "k": "whole", "kind": "text", "text": "text", "error": "text", "value": "number", "limit": "number",
    "code": "text", "code_values": "text",
}  # fmt: skip
"""`code_values` is JSON: what belongs to the code, which says the same as the text."""
COMPENSATION_CELLS: Final[CellKinds] = {
    "time": "time", "mode": "text", "source": "text", "x_um": "number", "y_um": "number", "z_um": "number",
    "written": "whole",
}  # fmt: skip
COMMANDS: Final[CellKinds] = {"time": "time", "name": "text", "by": "text", "accepted": "whole", "text": "text"}
RUNS: Final[CellKinds] = {
    "time": "time", "run": "whole", "kind": "text", "step_s": "number", "inputs": "text", "talc": "text",
    "fingerprint": "text", "versions": "text",
}  # fmt: skip
"""`inputs` is a list and `talc` the section of the configuration, both JSON."""
MODEL_CELLS: Final[CellKinds] = {"time": "time", "after_k": "whole", "fingerprint": "text", "models": "text"}

REASON_CELLS: Final[CellKinds] = {
    "time": "time", "k": "whole", "next_k": "whole", "next_why": "text", **_nine("estimate"), **_nine("believed"),
    **_nine("level"), **_nine("other_inputs"), **_nine("expected"), **_nine("expected_sigma"), "inputs": "text",
    "experts": "text",
}  # fmt: skip
"""`inputs` and `experts` are JSON: by error, the parts of the largest inputs and the weights of the kinds of expert."""


def steps(inputs: Sequence[str]) -> CellKinds:
    """Columns of steps with these inputs."""
    decided = {**_nine("predicted"), **_nine("corrected"), **_nine("sigma"), **_nine("limit")}
    return {
        "k": "whole", "time": "time", "phase": "text", **{f"input_{name}": "number" for name in inputs},
        **_nine("measured"), **decided, **{f"trusted_{name}": "whole" for name in THERMAL_ERRORS},
        "measurement_wanted": "text", **_nine("measured_sigma"), "pause_unknown": "whole",
    }  # fmt: skip


def step_cells(step: StoredStep, step_s: float) -> Cells:
    """Cells of one step, in the order of its inputs."""
    frame, decision = step.frame, step.decision
    values = [x if ok else None for x, ok in zip(frame.inputs.tolist(), frame.valid.tolist(), strict=True)]
    measured = _NO_ERRORS if frame.measurement is None else frame.measurement.errors.tolist()
    measured_sigma = _NO_ERRORS if frame.measurement is None else frame.measurement.sigma.tolist()
    made = (decision.predicted, decision.corrected, decision.sigma, decision.limits)
    return (
        frame.k, utc(frame.k * step_s), decision.phase.value, *values, *measured,
        *(x for array in made for x in array.tolist()), *map(int, decision.trusted.tolist()),
        None if decision.measure is None else decision.measure.value, *measured_sigma, int(frame.pause_unknown),
    )  # fmt: skip


def measurement_cells(m: StoredMeasurement) -> Cells:
    """Cells of one probing cycle."""
    return m.number, m.ended, m.why, *(_NO_ERRORS if m.errors is None else m.errors.tolist()), m.reason


def event_cells(found: tuple[datetime, int | None, Event]) -> Cells:
    """Cells of one event."""
    at, k, e = found
    values = json.dumps(json_of(e.values)) if e.code else None
    return at, k, e.kind.value, e.text, e.error, e.value, e.limit, e.code or None, values


def command_cells(outcome: CommandOutcome) -> Cells:
    """Cells of one command."""
    command = outcome.command
    return outcome.time, command.name.value, command.by, int(outcome.accepted), outcome.text


def reasons_cells(time: datetime, reasons: Reasons) -> Cells:
    """Cells of the learner's reasons of one step."""
    found = {e.error: e for e in reasons.errors}
    each = [found.get(name) for name in THERMAL_ERRORS]
    return (
        time, reasons.k, reasons.next_k, reasons.next_why.value,
        *(None if e is None else e.estimate for e in each), *(None if e is None else e.believed for e in each),
        *(None if e is None else e.level for e in each), *(None if e is None else e.other_inputs for e in each),
        *(None if e is None else e.expected for e in each), *(None if e is None else e.expected_sigma for e in each),
        json.dumps({name: _known(e.inputs) for name, e in found.items()}),
        json.dumps({name: _known(e.experts) for name, e in found.items()}),
    )  # fmt: skip


def _known(pairs: Sequence[tuple[str, float]]) -> dict[str, float | None]:
    """Without NaN, which JSON does not have."""
    return {name: value if math.isfinite(value) else None for name, value in pairs}


def run_cells(run: StoredRun) -> Cells:
    """Cells of one start of the gateway."""
    inputs = json.dumps(run.inputs)
    return run.began, run.number, run.kind, run.step_s, inputs, run.talc, run.fingerprint, run.versions


def compensation_cells(c: StoredCompensation) -> Cells:
    """Cells of one step of the compensation."""
    return c.time, c.mode, c.source, *c.offsets_um.tolist(), int(c.written)


def utc(timestamp: float) -> datetime:
    """A time of seconds since 1970."""
    return datetime.fromtimestamp(timestamp, UTC)
