"""Messages as InfluxDB's line protocol: which measurements, tags and fields they have.

The time of a line is the time of what it reports, never the time of sending, so a line that is sent twice overwrites
itself.
"""

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta

from gateway.listeners.outlets.outlet import OutletMessage
from gateway.telemetry import keys
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    MeasurementMessage,
    ReadingMessage,
    StatusMessage,
)
from gateway.telemetry.subscriber.instants import instant

WRITTEN = frozenset((keys.READING, keys.DECISION, keys.MEASUREMENT, keys.EVENT, keys.COMPENSATION, keys.STATUS))
"""Kinds of key that become lines."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
Field = float | int | bool | str | None


def line(measurement: str, tags: Mapping[str, str], fields: Mapping[str, Field], at: datetime) -> str | None:
    """One line; None if no field has a value. Empty tags are left out, as the protocol has none, and whole numbers that
    it cannot write: the server would refuse all lines that are sent with them."""
    known = ((name, value) for name, value in fields.items() if value is not None and not _too_large(value))
    written = ",".join(f"{_escaped(name)}={_value(value)}" for name, value in known)
    if not written:
        return None
    tagged = "".join(f",{_escaped(name)}={_escaped(text)}" for name, text in sorted(tags.items()) if text)
    nanoseconds = (at - _EPOCH) // timedelta(microseconds=1) * 1000
    return f"{_escaped(measurement)}{tagged} {written} {nanoseconds}"


def _escaped(text: str) -> str:
    """A name or a tag's value. It may not hold a line's end, nor end with a backslash, which would escape what follows;
    a backslash elsewhere stands for itself (and before a comma, blank or equals sign cannot be written)."""
    plain = "".join(" " if character in "\n\r\t\0" else character for character in text).replace("\\", "/")
    return plain.replace(",", r"\,").replace("=", r"\=").replace(" ", r"\ ")


def _too_large(value: Field) -> bool:
    return isinstance(value, int) and not -(2**63) <= value < 2**63


def _value(value: float | int | bool | str) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return f"{value}i"
        case float():
            return repr(value)
        case str():
            plain = "".join(" " if character in "\n\r\0" else character for character in value)
            return '"' + plain.replace("\\", r"\\").replace('"', r"\"") + '"'


def lines(told: OutletMessage) -> Iterator[str]:
    """The lines of one message; none for a message that is not written, or whose time is invalid."""
    for measurement, tags, fields, time in _entries(told):
        at = instant(time)
        found = None if at is None else line(measurement, {"machine": told.machine, **tags}, fields, at)
        if found is not None:
            yield found


def _entries(told: OutletMessage) -> Iterator[tuple[str, dict[str, str], dict[str, Field], str]]:
    """Measurement, tags, fields and time."""
    match told.message:
        case ReadingMessage() as m:
            # One that is not good has the time at which this was noticed: it must not overwrite the value before.
            time = m.source_time if m.value is not None else m.time
            fields: dict[str, Field] = {"value": m.value, "quality": m.quality, "detail": m.detail or None}
            yield keys.READING, {"channel": m.channel, "unit": m.unit}, fields, time
        case DecisionMessage() as m:
            yield "control", {}, {"phase": m.phase, "k": m.k, "measure": m.measure}, m.time
            for error in m.corrected:
                values: dict[str, Field] = {
                    "predicted": m.predicted.get(error),
                    "corrected": m.corrected.get(error),
                    "sigma": m.sigma.get(error),
                    "limit": m.limits.get(error),
                    "trusted": m.trusted.get(error),
                }
                yield keys.DECISION, {"error": error}, values, m.time
        case MeasurementMessage() as m:
            told_of: dict[str, Field] = {"number": m.number, "why": m.why, "residual_um": m.residual_um,
                                         "reason": m.reason or None}  # fmt: skip
            yield "cycle", {}, told_of, m.ended
            for error, value in (m.errors or {}).items():
                yield keys.MEASUREMENT, {"error": error}, {"value": value, "sigma": (m.sigma or {}).get(error)}, m.ended
        case CompensationMessage() as m:
            for axis, target, offset in zip("XYZ", m.target_um, m.offsets_um, strict=True):
                moved: dict[str, Field] = {"target_um": target, "offset_um": offset, "written": m.written}
                yield keys.COMPENSATION, {"axis": axis, "mode": m.mode}, moved, m.time
        case EventMessage() as m:
            said: dict[str, Field] = {"text": m.text, "value": m.value, "limit": m.limit}
            yield keys.EVENT, {"kind": m.kind, "error": m.error or ""}, said, m.time
        case StatusMessage() as m:
            state: dict[str, Field] = {
                "phase": m.phase,
                "uptime_s": m.uptime_s,
                "channels": m.channels,
                "channels_good": m.channels_good,
                "nc": m.nc,
                "clock_synchronised": m.clock_synchronised,
                "waits_for": len(m.waits_for),
                "readings_dropped": m.readings_dropped,
                "messages_dropped": m.messages_dropped,
            }
            yield keys.STATUS, {}, state, m.time
        case _:
            pass
