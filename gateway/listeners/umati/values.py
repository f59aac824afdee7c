"""Present values of one machine's nodes, with OPC UA status and source time, from what was heard of its gateway."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Final

from drivers.base import Quality
from gateway.telemetry.messages import ReadingMessage
from gateway.telemetry.subscriber.instants import instant
from gateway.telemetry.subscriber.machine import MachineSeen, applied, believable, is_old
from talc.names import THERMAL_ERRORS

GOOD: Final = "Good"
OLD: Final = "UncertainLastUsableValue"
NOT_HEARD: Final = "BadNoCommunication"
NOTHING: Final = "BadNoData"
_SILENT_S = 60.0
"""A gateway reports its state every 10 s: after this long without a report, nothing that it said counts as current."""
_BY_QUALITY: Final[Mapping[str, str]] = {
    Quality.GOOD: GOOD,
    Quality.STALE: OLD,
    Quality.COMM_FAULT: NOT_HEARD,
    Quality.SENSOR_FAULT: "BadSensorFailure",
    Quality.OUT_OF_RANGE: "BadOutOfRange",
}

Plain = float | int | str | datetime | tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NodeShown:
    """What one node shows."""

    value: Plain | None
    """None: the status is bad."""
    status: str
    """Name of an OPC UA status code (Part 4, 7.39)."""
    at: datetime | None
    """When the value was taken, by the gateway's clock; None without one."""


UNKNOWN: Final = NodeShown(None, NOTHING, None)
"""A value that the gateway does not know, or has not sent since it started again."""
ACTIVITY: Final = "Probing cycle that measures the thermal errors"
ERRORS_FOLDER: Final = "ThermalErrors"
SIGMAS: Final = "StandardUncertainties"
OFFSETS_FOLDER: Final = "Offsets"
CHANNELS: Final = "Channels"
NEXT: Final = "Next"
RUN: Final = "Gateway"
_PROGNOSIS = ("PredictedTime", "Activity", "Reason")
_STATES = ("Phase", "Control", "ChannelsConfigured", "ChannelsGood", "WaitsFor", "Version")
Path = tuple[str, str]
"""Group and name of a value."""


def shown_now(seen: MachineSeen, now_s: float) -> dict[Path, NodeShown]:
    """By group and name, at this monotonic time.

    Of a gateway that is gone every value is bad, and of two of one name. Of one that is alive but has not been heard
    for a minute every value is uncertain.
    """
    found = dict(_all(seen, now_s))
    if not seen.alive or seen.two:
        return dict.fromkeys(found, NodeShown(None, NOT_HEARD, None))
    if now_s - seen.latest_s > _SILENT_S:
        return {path: _aged(shown) for path, shown in found.items()}
    return found


def _all(seen: MachineSeen, now_s: float) -> Iterator[tuple[Path, NodeShown]]:
    yield from _errors(seen, now_s)
    yield from _offsets(seen)
    for channel, message in seen.readings.items():
        yield (CHANNELS, channel), _reading(message)
    yield from _next(seen, now_s)
    yield from _state(seen)


def _aged(shown: NodeShown) -> NodeShown:
    return replace(shown, status=OLD) if shown.status == GOOD else shown


def _number_shown(value: float | None, status: str, at: datetime | None) -> NodeShown:
    """A number, if it is one and bears a time."""
    known = believable(value)
    return UNKNOWN if at is None or math.isnan(known) else NodeShown(known, status, at)


def _errors(seen: MachineSeen, now_s: float) -> Iterator[tuple[Path, NodeShown]]:
    """The best estimates and their sigma, µm and µm/m."""
    decision = seen.decision
    at = None if decision is None else instant(decision.time)
    status = OLD if is_old(seen, now_s) else GOOD
    for error in THERMAL_ERRORS:
        value = sigma = None
        if decision is not None:
            value, sigma = decision.corrected.get(error), decision.sigma.get(error)
        yield (ERRORS_FOLDER, error), _number_shown(value, status, at)
        yield (SIGMAS, error), _number_shown(sigma, status, at)


def _offsets(seen: MachineSeen) -> Iterator[tuple[Path, NodeShown]]:
    """In force on the control, µm."""
    step = seen.compensation
    at = None if step is None else instant(step.time)
    for axis, offset in zip("XYZ", applied(step).offsets_um, strict=True):
        yield (OFFSETS_FOLDER, axis), _number_shown(offset, GOOD, at)


def _reading(message: ReadingMessage) -> NodeShown:
    status, at = _BY_QUALITY.get(message.quality, NOTHING), instant(message.source_time)
    if status.startswith("Bad"):
        return NodeShown(None, status, at)
    value = message.value
    if value is None or not math.isfinite(value) or at is None:
        return UNKNOWN
    return NodeShown(value, status, at)


def _next(seen: MachineSeen, now_s: float) -> Iterator[tuple[Path, NodeShown]]:
    """The next probing cycle, when the learner gives a time for it; uncertain once this time has passed."""
    reasons = seen.reasons
    expected = None if reasons is None else seen.at_k(reasons.next_k)
    said, clock = None if reasons is None else instant(reasons.time), seen.clock(now_s)
    if reasons is None or expected is None or said is None or clock is None:
        told = dict.fromkeys(_PROGNOSIS, UNKNOWN)
    else:
        status = GOOD if clock <= expected else OLD
        values: tuple[Plain, ...] = (expected, ACTIVITY, reasons.next_why)
        told = {name: NodeShown(value, status, said) for name, value in zip(_PROGNOSIS, values, strict=True)}
    for name, shown in told.items():
        yield (NEXT, name), shown
    standing, at = seen.probing, seen.latest
    yield (NEXT, "Standing"), UNKNOWN if standing is None or at is None else NodeShown(standing.standing, GOOD, at)


def _state(seen: MachineSeen) -> Iterator[tuple[Path, NodeShown]]:
    """The state of the gateway."""
    status = seen.status
    at = None if status is None else instant(status.time)
    if status is None or at is None:
        values: tuple[Plain | None, ...] = (None,) * len(_STATES)
    else:
        values = (status.phase, status.nc, status.channels, status.channels_good, status.waits_for, status.version)
    for name, value in zip(_STATES, values, strict=True):
        yield (RUN, name), UNKNOWN if value is None else NodeShown(value, GOOD, at)
