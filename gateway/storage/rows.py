"""Converts between values and the database's rows.

Arrays are little-endian float64 blobs, models are JSON with floats that round-trip: what is read equals what was
written, bit for bit.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from typing import Any, Final

import numpy as np

from gateway.config.outline import inputs_if_known, outlined, step_s_of
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.compensation import Write
from gateway.model.probing import Outcome
from gateway.model.step_time import StepTime
from gateway.model.text import json_of, plain, restored, values_of
from gateway.model.wording import worded
from gateway.storage.learnt import Reference
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredRun, StoredStep
from talc.explanation import ErrorReason, Reasons
from talc.frame import (
    BoolArray,
    Decision,
    Event,
    EventKind,
    FloatArray,
    Frame,
    Frames,
    Measurement,
    Phase,
    Why,
)
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS

Row = tuple[object, ...]

STEP_COLUMNS = (
    "f.k, f.inputs, f.valid, f.errors, f.sigma, d.phase, d.predicted, d.corrected, d.sigma, d.limits,"
    " d.measure, d.training, d.events"
)
"""And `t.trusted`, or NULL from a file of an earlier program."""
RUN_COLUMNS = "number, began, config, fingerprint, versions"
MEASUREMENT_COLUMNS = "number, why, ended, centres, in_force, errors, reason, asked"
EVENT_COLUMNS = "time, k, kind, text, error, value, bound"
CODE_OF_EVENT, CODE_OF_REASON = (
    ", ".join(f"(SELECT {name} FROM coded WHERE coded.text = {of})" for name in ("code", "content"))
    for of in ("event.text", "measurement.reason")
)
NO_CODE = "NULL, NULL"
"""In their place, in a file of an earlier program, which stored only what it said."""
COMPENSATION_COLUMNS = "time, mode, source, offsets, written"
COMMAND_COLUMNS = "time, name, by, accepted, text"


REFERENCE: Final = (
    f"SELECT * FROM measurement WHERE why = '{Why.REFERENCE}' OR id ="
    " (SELECT min(id) FROM measurement WHERE errors IS NOT NULL AND centres IS NOT NULL)"
    f" ORDER BY why = '{Why.REFERENCE}' DESC, id DESC LIMIT 1"
)
"""The row of `measurement` that errors count from: the latest new reference for which a person asked, without errors
while it is still to be measured; if there is none, the first that was used."""


def _in_force(begins: CommandName, ends: CommandName) -> str:
    """The first of these commands since the last one that ends it: repeating a command does not begin it again."""
    return (
        f"SELECT {COMMAND_COLUMNS} FROM command WHERE accepted AND name = '{begins}' AND id >"
        f" (SELECT coalesce(max(id), 0) FROM command WHERE accepted AND name = '{ends}') ORDER BY id LIMIT 1"
    )


STANDING: Final[Mapping[CommandName, str]] = {
    CommandName.PAUSE: _in_force(CommandName.PAUSE, CommandName.RESUME),
    CommandName.DISARM: _in_force(CommandName.DISARM, CommandName.ARM),
}
"""Commands that last until another one ends them, and the query for the one that lasts now."""
ENDS: Final[Mapping[CommandName, CommandName]] = {
    CommandName.RESUME: CommandName.PAUSE,
    CommandName.ARM: CommandName.DISARM,
}
"""Each command that ends another one, and the one that it ends."""


def of_frame(boot: str, frame: Frame) -> Row:
    """Row of `frame`."""
    m = frame.measurement
    return (
        frame.k, boot, _blob(frame.inputs), np.packbits(frame.valid).tobytes(),
        None if m is None else _blob(m.errors), None if m is None else _blob(m.sigma),
    )  # fmt: skip


def of_moment(moment: StepTime) -> Row:
    """Row of `moment`, without its slot."""
    return moment.k, moment.origin, moment.monotonic_s, moment.lead_s, int(moment.known)


def of_decision(decision: Decision) -> Row:
    """Row of `decision`."""
    events = [[e.kind.value, e.text, e.error, e.value, e.limit] for e in map(worded, decision.events)]
    return (
        decision.k, decision.phase.value, _blob(decision.predicted), _blob(decision.corrected),
        _blob(decision.sigma), _blob(decision.limits), decision.measure and decision.measure.value,
        decision.training and decision.training.why.value, json.dumps(events),
    )  # fmt: skip


def of_trust(decision: Decision) -> Row:
    """Row of `trust`."""
    return decision.k, np.packbits(decision.trusted).tobytes()


def of_reasons(reasons: Reasons) -> str:
    """Column `reasons`."""
    return json.dumps(asdict(reasons))


def of_outcome(outcome: Outcome) -> Row:
    """Row of `measurement`, without its id."""
    m = outcome.measurement
    return (
        outcome.number, outcome.why.value, outcome.asked.isoformat(), outcome.ended.isoformat(),
        None if outcome.centres_mm is None else _blob(outcome.centres_mm), _blob(outcome.in_force_um),
        None if m is None else _blob(m.errors), None if m is None else _blob(m.sigma), outcome.residual_um,
        outcome.reason,
    )  # fmt: skip


def of_reference(first: Reference) -> Row:
    """Row of `measurement`, without its id, of a first measurement that is known from elsewhere."""
    ended = first.ended.isoformat()
    return (
        0, Why.CALIBRATION.value, ended, ended, _blob(first.centres_mm), _blob(first.in_force_um), _blob(first.errors),
        None, None, "",
    )  # fmt: skip


def reference_of(row: Sequence[Any]) -> Reference | None:
    """What a row of `measurement`, without its id, says of the reference; None: it is still to be measured."""
    number, why, asked, ended, centres, in_force, errors, *_, reason = row
    found = measurement_of((number, why, ended, centres, in_force, errors, reason, asked))
    if found.centres_mm is None or found.errors is None:
        return None
    return Reference(found.ended, found.centres_mm, found.in_force_um, found.errors)


def of_models(models: ModelSet, after_k: int) -> Row:
    """Row of `model`, without its id."""
    return after_k, models.fingerprint(), json.dumps(models.to_dict())


def of_event(event: Event, k: int | None, time: datetime) -> Row:
    """Row of `event`, without its id."""
    return time.isoformat(), k, event.kind.value, event.text, event.error, event.value, event.limit


def of_texts(*texts: str) -> list[Row]:
    """Rows of `coded`, without their ids, of those that are not only words."""
    coded = ((str(text), *values_of(text)) for text in texts)
    return [(text, code, json.dumps(values)) for text, code, values in coded if code]


def of_codes(events: Iterable[Event]) -> list[Row]:
    """Rows of `coded`, without their ids, of events in words that are not only words."""
    return [(str(e.text), e.code, json.dumps(json_of(e.values))) for e in events if e.code or e.values]


def of_command(outcome: CommandOutcome) -> Row:
    """Row of `command`, without its id."""
    name, by = outcome.command.name.value, outcome.command.by
    return outcome.time.isoformat(), name, by, int(outcome.accepted), outcome.text


def of_write(write: Write) -> Row:
    """Row of `compensation`, without its id."""
    return (
        write.time.isoformat(), write.mode, write.step.source.value, write.k, _blob(write.step.target_um),
        _blob(write.step.offsets_um), json.dumps(dict(write.positions)), int(write.written),
        None if write.read_back_um is None else _blob(write.read_back_um), _blob(write.step.coefficients_um),
    )  # fmt: skip


def command_of(row: Sequence[Any]) -> CommandOutcome:
    """From COMMAND_COLUMNS."""
    time, name, by, accepted, text = row
    return CommandOutcome(Command(CommandName(name), by), datetime.fromisoformat(time), bool(accepted), plain(text))


def models_of(text: str) -> ModelSet:
    """From column `models`."""
    return ModelSet.from_dict(json.loads(text))


def step_of(row: Sequence[Any], adopted: Sequence[ModelSet]) -> StoredStep:
    """From STEP_COLUMNS and `trusted`, and the models that were adopted after the step."""
    k, frame_inputs, valid, errors, measured_sigma, phase, *four, measure, training, events, trusted = row
    inputs = _array(frame_inputs)
    measurement = None if errors is None else Measurement(_array(errors), _array(measured_sigma))
    predicted, corrected, sigma, limits = (_array(blob) for blob in four)
    decision = Decision(
        k=k, phase=Phase(phase), predicted=predicted, corrected=corrected, sigma=sigma, limits=limits,
        measure=None if measure is None else Why(measure), training=None,
        events=tuple(_event(parts) for parts in json.loads(events)),
    )  # fmt: skip
    if trusted is not None:
        decision = replace(decision, trusted=_mask(trusted, len(THERMAL_ERRORS)))
    # A frame with a new reference, or another tolerance, is told by what was decided of it.
    anew = any(event.kind is EventKind.NEW_REFERENCE for event in decision.events)
    stated = next((e.value for e in decision.events if e.kind is EventKind.TOLERANCE_STATED), None)
    frame = Frame(k, inputs, _mask(valid, inputs.size), measurement, new_reference=anew, tolerance_um=stated)
    return StoredStep(frame, decision, training, tuple(adopted), trusted is not None)


def frames_of(found: Sequence[Sequence[Any]]) -> Frames:
    """From columns k, inputs, valid and errors of `frame`; one or more rows."""
    nothing, many = bytes(8 * len(THERMAL_ERRORS)), len(found)
    k = np.array([row[0] for row in found], dtype=np.int64)
    inputs = _array(b"".join(row[1] for row in found)).reshape(many, -1)
    masks = np.frombuffer(b"".join(row[2] for row in found), dtype=np.uint8).reshape(many, -1)
    valid = np.unpackbits(masks, axis=1, count=inputs.shape[1]).astype(np.bool_)
    measured = _array(b"".join(row[3] or nothing for row in found)).reshape(many, len(THERMAL_ERRORS))
    measured[[row[3] is None for row in found]] = np.nan
    return Frames(k, inputs, valid, measured)


def run_of(row: Sequence[Any]) -> StoredRun:
    """From RUN_COLUMNS; of a configuration that is not one of this gateway only what it has."""
    number, began, config, fingerprint, versions = row
    data = outlined(config)
    return StoredRun(
        number, datetime.fromisoformat(began), data.get("machine", {}).get("kind"), step_s_of(config),
        inputs_if_known(config), json.dumps(data.get("talc", {})), fingerprint, versions,
    )  # fmt: skip


def reasons_of(text: str) -> Reasons:
    """From column `reasons`."""
    whole = json.loads(text)
    errors = (
        ErrorReason(
            e["error"], e["estimate"], e["trusted"], e["believed"], _pairs(e["inputs"]), e["other_inputs"], e["level"],
            _pairs(e["experts"]), e["expected"], e["expected_sigma"],
        )
        for e in whole["errors"]
    )  # fmt: skip
    return Reasons(whole["k"], whole["next_k"], Why(whole["next_why"]), tuple(errors))


def _pairs(values: Sequence[Sequence[Any]]) -> tuple[tuple[str, float], ...]:
    return tuple((name, value) for name, value in values)


def measurement_of(row: Sequence[Any]) -> StoredMeasurement:
    """From MEASUREMENT_COLUMNS."""
    number, why, ended, centres, in_force, errors, reason, asked = row
    return StoredMeasurement(
        number, why, datetime.fromisoformat(ended), None if centres is None else _array(centres).reshape(-1, 3),
        _array(in_force).reshape(-1, 3).squeeze(), None if errors is None else _array(errors), reason,
        datetime.fromisoformat(asked),
    )  # fmt: skip


def coded_measurement_of(row: Sequence[Any]) -> StoredMeasurement:
    """From MEASUREMENT_COLUMNS and CODE_OF_REASON."""
    *plain_row, code, content = row
    found = measurement_of(plain_row)
    return found if code is None else replace(found, reason=restored(found.reason, code, json.loads(content)))


def event_of(row: Sequence[Any]) -> tuple[datetime, int | None, Event]:
    """From EVENT_COLUMNS: UTC, grid index and event."""
    time, k, *parts = row
    return datetime.fromisoformat(time), k, _event(parts)


def coded_event_of(row: Sequence[Any]) -> tuple[datetime, int | None, Event]:
    """From EVENT_COLUMNS and CODE_OF_EVENT."""
    *plain_row, code, content = row
    at, k, event = event_of(plain_row)
    if code is None:
        return at, k, event
    text = restored(event.text, code, json.loads(content))
    return at, k, replace(event, text=text, code=code, values=text.values)


def compensation_of(row: Sequence[Any]) -> StoredCompensation:
    """From COMPENSATION_COLUMNS."""
    time, mode, source, offsets, written = row
    return StoredCompensation(datetime.fromisoformat(time), mode, source, _array(offsets), bool(written))


def _blob(values: object) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def _array(blob: bytes) -> FloatArray:
    return np.frombuffer(blob, dtype="<f8").astype(np.float64)


def _mask(blob: bytes, size: int) -> BoolArray:
    return np.unpackbits(np.frombuffer(blob, dtype=np.uint8), count=size).astype(np.bool_)


def _event(parts: Sequence[Any]) -> Event:
    kind, text, error, value, limit = parts
    return Event(EventKind(kind), text, error, value, limit)
