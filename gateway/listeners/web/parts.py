"""The parts of the page below the first: what it waits for, heat, health, events. Samples in, sentences out."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from statistics import median

from drivers.base import Quality
from gateway.listeners.web.ahead import measures
from gateway.listeners.web.catalogue import page_texts
from gateway.listeners.web.sentences import Amount, Atom, SaidRow, Sentence, ToldName, Word, at, in_each, name, told, um
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source
from gateway.model.control_state import NcState
from gateway.model.standing import Standing
from gateway.model.text import Text, plain, restored
from gateway.model.wording import finding_text
from gateway.telemetry.fields import text_from, texts_from
from gateway.telemetry.messages import (
    EventMessage,
    MeasurementMessage,
    ProbingStanding,
    SensorFinding,
    StatusMessage,
    StorageStanding,
)
from gateway.telemetry.subscriber.instants import instant
from gateway.telemetry.subscriber.machine import MachineSeen, believable, is_past
from talc.frame import EventKind
from talc.names import ERROR_UNITS, LEAST_NAMED, MOST_NAMED, THERMAL_ERRORS

_CELSIUS = "°C"
_BODIES = {
    "spindle": {"spindle", "head"},
    "column": {"column", "frame"},
    "bed": {"bed", "base"},
    "cradle": {"a", "cradle"},
    "table": {"c", "table"},
    "slides": {"x", "y", "z"},
    "fluids": {"coolant", "fluid", "oil"},
    "ambient": {"ambient", "space", "air", "room"},
}
"""Part of the sketch to words in the names of its channels; the first that fits."""
_BAD = frozenset({EventKind.PROBLEM, EventKind.MEASUREMENT_REJECTED, EventKind.MODEL_REJECTED})
_NC_MARKS: dict[str, str] = {NcState.READY: "good", NcState.PROBING: "good", NcState.NONE: ""}
"""Marks of the control's states; any other is a notice."""
_MOST_ALIKE = 4
_RENEW_DAYS = 30
_URGENT_DAYS = 7
_ORDERS = frozenset({NoticeCode.WAITS_ARM, NoticeCode.WAITS_RESUME})
"""What an order waits for is said where the order is."""
_AROUND = frozenset({NoticeCode.INTERMITTENT, NoticeCode.NO_MORE_KINDS})
"""What is said around another problem."""
TOLD_WITH_REMEDY = frozenset({
    NoticeCode.CHANNEL_BAD, NoticeCode.BUS_SLOW, NoticeCode.OTHER_MASTER, NoticeCode.NC_AXES_FROZEN,
    NoticeCode.NC_VALUES_UNKNOWN, NoticeCode.NC_WATCHDOG_UNHEARD, NoticeCode.NC_PROBES_ON, NoticeCode.NC_SLOW,
    NoticeCode.STORE_FAILS, NoticeCode.DISK_LOW, NoticeCode.CLOCK_UNKNOWN, NoticeCode.CLOCK_AND_PAUSE_UNKNOWN,
    NoticeCode.TELEMETRY_UNCONFIRMED, NoticeCode.TWO_OF_ONE_NAME,
})  # fmt: skip
"""Problems whose sentences say what to do."""
_NOTABLE = frozenset({EventKind.OPERATOR, EventKind.SENSOR_SUSPECT, EventKind.COMMAND})


def waits(seen: MachineSeen) -> Iterator[SaidRow]:
    """What is not armed, phase, next probing and why, what blocks it, what the operator should do."""
    for text in seen.unarmed:
        yield SaidRow("label.unarmed", told(text), "notice")
    if seen.unarmed:
        yield SaidRow("label.operator", Sentence("do.unarmed"))
    if seen.decision is not None:
        yield SaidRow("label.phase", Sentence("sentence.word", {"word": Word(f"phase.{seen.decision.phase}")}))
    status = seen.status
    for text in () if status is None else texts_from(status.waits_for, status.waits_for_coded):
        if text.code not in _ORDERS:
            yield SaidRow("label.first", told(text), "notice")
    yield from _standing(seen.probing)
    asked = seen.probing is not None and seen.probing.standing == Standing.ASKED
    expected = None if seen.reasons is None or asked or not measures(seen) else seen.at_k(seen.reasons.next_k)
    if seen.reasons is not None and expected is not None:
        why = Word(f"why.{seen.reasons.next_why}")
        key = "next.overdue" if is_past(seen, expected) else "next.expected"
        yield SaidRow("label.next", Sentence(key, {"at": at(expected), "why": why}))
    yield _last(seen.last_measurement)


def _standing(standing: ProbingStanding | None) -> Iterator[SaidRow]:
    if standing is None:
        yield SaidRow("label.probing", Sentence("probing.nothing_heard"))
        return
    wanted = Sentence("sentence.word", {"word": Word(f"standing.{standing.standing}")})
    yield SaidRow("label.probing", wanted, "notice" if standing.standing == Standing.BLOCKED else "")
    if standing.why is not None:
        yield SaidRow("label.why", Sentence("sentence.word", {"word": Word(f"why.{standing.why}")}))
    if standing.reason:
        yield SaidRow(
            "label.waits_for",
            told(text_from(standing.reason, standing.reason_coded)),
            "notice" if standing.standing == Standing.BLOCKED else "",
        )
    if standing.rejected:
        yield SaidRow("label.rejected", Sentence("probing.rejected", {"n": Amount(standing.rejected, d=0)}), "bad")
    if standing.operator:
        yield SaidRow("label.operator", told(text_from(standing.operator, standing.operator_coded)), "notice")


def _last(message: MeasurementMessage | None) -> SaidRow:
    if message is None:
        return SaidRow("label.last", Sentence("last.none"))
    ended = at(datetime.fromisoformat(message.ended))
    if message.errors is None:
        reason = in_each(text_from(message.reason, message.reason_coded))
        return SaidRow("label.last", Sentence("last.failed", {"at": ended, "reason": reason}), "bad")
    return SaidRow("label.last", Sentence("last.used", {"at": ended}), "good")


@dataclass(frozen=True, slots=True)
class ShownChannel:
    """One reading, or why there is none."""

    channel: str
    value: Amount | None
    quality: str
    """Key of the catalogue."""
    good: bool
    detail: Sentence | None
    body: str
    """Part of the machine in the sketch, by its name; empty: none."""
    doubt: str = ""
    """`offset` or `swap`: what the comparison with the others has found; empty: nothing."""
    beside: tuple[str, ...] = ()
    """With which it may be exchanged, or what would explain the offset as well."""


@dataclass(frozen=True, slots=True)
class DrivenError:
    """What moves one thermal error now."""

    error: str
    estimate: Amount
    corrected: bool
    movers: tuple[tuple[str, Amount], ...]
    """Names of inputs and by how much, the largest first."""
    others: Amount
    """All other inputs together."""
    level: Amount
    """What no input explains, as the last measurements left it. With `movers` and `others` it is the estimate."""


def channels(seen: MachineSeen) -> Iterator[ShownChannel]:
    """Every channel, those that are not good first, then the temperatures."""
    doubted = _doubted(seen)
    shown = [
        ShownChannel(
            r.channel,
            None if r.value is None else Amount(r.value, _unit(r.unit), d=1),
            f"quality.{r.quality}",
            r.quality == Quality.GOOD,
            told(text_from(r.detail, r.detail_coded)) if r.detail else None,
            _body(r.channel),
            *doubted.get(r.channel, ("", ())),
        )
        for r in seen.readings.values()
    ]
    yield from sorted(shown, key=lambda c: (c.good, not c.doubt, c.value is None or c.value.u != _CELSIUS, c.channel))


def other_inputs(seen: MachineSeen) -> Iterator[tuple[str, float | None]]:
    """Inputs of the last grid step that are no channels, such as loads; None: without a good value."""
    for channel, value in {} if seen.frame is None else seen.frame.inputs.items():
        if channel not in seen.readings:
            yield channel, value if math.isfinite(believable(value)) else None


def _doubted(seen: MachineSeen) -> dict[str, tuple[str, tuple[str, ...]]]:
    """By input, the kind of the finding and the inputs that it concerns besides."""
    found: dict[str, tuple[str, tuple[str, ...]]] = {}
    for finding in () if seen.sensors is None else seen.sensors.findings:
        own = (*finding.inputs, *finding.alternatives)
        for each in own:
            found.setdefault(each, (finding.kind, tuple(other for other in own if other != each)))
    return found


def _body(channel: str) -> str:
    """The part of the machine that a channel's name tells, as `bed_front_left` does."""
    words = channel.lower().replace("-", "_").split("_")
    return next((body for body, told in _BODIES.items() if told & set(words)), "")


def driven(seen: MachineSeen) -> Iterator[DrivenError]:
    """By thermal error that has an estimate, what moves it now."""
    reasons = {} if seen.reasons is None else seen.reasons.errors
    for error in THERMAL_ERRORS:
        reason = reasons.get(error)
        if reason is None or reason.estimate is None:
            continue
        unit = ERROR_UNITS[error]
        moving = [(i, v) for i, v in reason.inputs.items() if v is not None and abs(v) >= LEAST_NAMED]
        largest = sorted(moving, key=lambda each: -abs(each[1]))[:MOST_NAMED]
        # Rounded parts add up to the rounded sum: what rounding leaves is among the other inputs.
        movers = tuple((i, Amount(round(v, 1), unit, sign=True)) for i, v in largest)
        level = round(reason.level or 0.0, 1)
        others = round(reason.estimate, 1) - level - sum(amount.n or 0.0 for _, amount in movers)
        yield DrivenError(
            error,
            Amount(reason.estimate, unit, sign=True),
            reason.trusted,
            movers,
            Amount(round(others, 1), unit, sign=True),
            Amount(level, unit, sign=True),
        )


def doubts(seen: MachineSeen) -> Iterator[Sentence]:
    """Sensors that fail, that disagree with the others, or whose value was replaced."""
    bad = sorted(r.channel for r in seen.readings.values() if r.quality != Quality.GOOD)
    if bad:
        yield Sentence("doubt.failed", {"names": ToldName(", ".join(bad))})
    if seen.sensors is not None:
        for finding in seen.sensors.findings:
            since = None if finding.since_k is None else seen.at_k(finding.since_k)
            yield _finding(finding, since, seen.sensors.loads)
    if seen.sensors is not None and seen.sensors.alike:
        pairs = "; ".join(" / ".join(pair) for pair in seen.sensors.alike[:_MOST_ALIKE])
        yield Sentence("doubt.alike", {"names": ToldName(pairs)})
    if seen.decision is not None and seen.decision.substituted:
        yield Sentence("doubt.substituted", {"names": ToldName(", ".join(seen.decision.substituted))})


def _finding(finding: SensorFinding, since: datetime | None, loads: tuple[str, ...]) -> Sentence:
    off = believable(finding.offset_K)
    if since is None or not math.isfinite(off):  # an exchange has no offset, and an earlier program sent no `since_k`
        return Sentence("doubt.finding", {"text": in_each(_found(finding))})
    names = " / ".join((*finding.inputs, *finding.alternatives))
    values: dict[str, Atom] = {"names": ToldName(names), "off": Amount(abs(off), "K"), "at": at(since)}
    if loads:
        values["loads"] = ToldName(", ".join(loads))
        return Sentence("doubt.warmer_for_loads" if off > 0.0 else "doubt.colder_for_loads", values)
    return Sentence("doubt.warmer" if off > 0.0 else "doubt.colder", values)


def _found(finding: SensorFinding) -> Text:
    swapped = finding.kind == "swap" and len(finding.inputs) == 2
    if not swapped and (finding.kind != "offset" or finding.offset_K is None):
        return plain(finding.text)  # of a later program
    return finding_text(finding.kind, finding.inputs, believable(finding.offset_K), finding.alternatives)


def watched(seen: MachineSeen) -> Sentence | None:
    """The smallest abnormal temperatures that loads and other sensors would have shown; None: not judged yet."""
    if seen.sensors is None:
        return None
    smallest = {i: v for i, v in seen.sensors.smallest_offset_K.items() if v is not None}
    if not smallest:
        return None
    worst = max(smallest, key=smallest.__getitem__)
    values: dict[str, Atom] = {
        "n": Amount(len(smallest), d=0),
        "median": Amount(median(smallest.values()), "K"),
        "worst": Amount(smallest[worst], "K"),
        "name": ToldName(worst),
    }
    if seen.sensors.loads:
        return Sentence("doubt.watched_with_loads", values | {"loads": ToldName(", ".join(seen.sensors.loads))})
    return Sentence("doubt.watched", values)


def health(seen: MachineSeen) -> Iterator[SaidRow]:
    """The health of the gateway itself."""
    yield SaidRow(
        "label.gateway", Sentence("gateway.alive" if seen.present else "gateway.gone"), "" if seen.present else "bad"
    )
    yield _channels(seen)
    step = seen.compensation
    if step is None:
        yield SaidRow("label.control", Sentence("control.nothing"))
    else:
        said = Sentence("control.step", {"mode": Word(f"mode.{step.mode}"), "source": Word(f"source.{step.source}")})
        yield SaidRow("label.control", said, "good" if step.written and step.source == Source.PREDICTION else "notice")
    if seen.status is not None:
        yield from _status(seen.status)
    yield from _certificates(seen)
    yield from _scatter(seen)
    yield _clock(seen)
    if seen.boot:
        yield SaidRow("label.boot", name(seen.boot))


def failed(seen: MachineSeen) -> Sentence | None:
    """How many channels have no good value now; None: all have one, or it is not known."""
    good, all_of_them = _counted(seen)
    if not seen.present or good >= all_of_them:
        return None
    values: dict[str, Atom] = {"n": Amount(all_of_them - good, d=0), "all": Amount(all_of_them, d=0)}
    lost = _lost(seen)
    if not lost:
        return Sentence("channels.failed", values)
    values["first"] = in_each(lost[0])
    if len(lost) > 1:
        return Sentence("channels.failed_more", values | {"more": Amount(len(lost) - 1, d=0)})
    return Sentence("channels.failed_at", values)


def _lost(seen: MachineSeen) -> list[Text]:
    """Buses that cannot be opened, then devices that do not answer, as this run of the gateway has said; none if each
    channel without a good value has a fault of its own: a device may only be slow."""
    bad = {reading.quality for reading in seen.readings.values()} - {Quality.GOOD}
    if bad and bad <= {Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE}:
        return []
    lost: dict[tuple[str, str], bool] = {}
    for event in seen.events:
        match event.values.get("subject"):
            case {"code": NoticeCode.BUS | NoticeCode.DEVICE as code, "values": {"name": str(name)}}:
                lost[code, name] = event.boot == seen.boot and event.kind == EventKind.PROBLEM
    return [Text(code, name=name) for (code, name), lasts in sorted(lost.items()) if lasts]


def _counted(seen: MachineSeen) -> tuple[int, int]:
    """Good channels, and all."""
    status = seen.status
    if status is not None and status.channels is not None and status.channels_good is not None:
        bad = sum(r.quality != Quality.GOOD for r in seen.readings.values())  # a reading comes before the next status
        return max(min(status.channels_good, status.channels - bad), 0), status.channels
    return sum(r.quality == Quality.GOOD for r in seen.readings.values()), len(seen.readings)


def _channels(seen: MachineSeen) -> SaidRow:
    good, all_of_them = _counted(seen)
    if not all_of_them:
        return SaidRow("label.channels", Sentence("channels.none"), "notice")
    said = Sentence("channels.good", {"good": Amount(good, d=0), "all": Amount(all_of_them, d=0)})
    return SaidRow("label.channels", said, "good" if good == all_of_them else "bad")


def _scatter(seen: MachineSeen) -> Iterator[SaidRow]:
    """How far the touches of the latest measurement are from a rigid body, beside those of the last hours."""
    found = [m.residual_um for m in seen.measurements if m.residual_um is not None]
    if found:
        values: dict[str, Atom] = {
            "now": um(found[-1]),
            "median": um(median(found)),
            "most": um(max(found)),
            "n": Amount(len(found), d=0),
        }
        yield SaidRow("label.scatter", Sentence("scatter.of", values))


def _certificates(seen: MachineSeen) -> Iterator[SaidRow]:
    for field, text in ({} if seen.status is None else seen.status.certificates).items():
        if (ends := instant(text)) is not None and seen.latest is not None:
            yield certificate_row(field, ends, seen.latest)


def certificate_row(field: str, ends: datetime, now: datetime) -> SaidRow:
    """How long a certificate is still valid, and what to do when that is not long."""
    days = math.floor((ends - now) / timedelta(days=1))
    values: dict[str, Atom] = {"field": ToldName(field), "n": Amount(days, d=0), "at": at(ends)}
    if days >= _RENEW_DAYS:
        return SaidRow("label.certificate", Sentence("certificate.good", values), "good")
    key = "certificate.ended" if ends <= now else "certificate.renew"
    return SaidRow("label.certificate", Sentence(key, values), "notice" if days >= _URGENT_DAYS else "bad")


def _clock(seen: MachineSeen) -> SaidRow:
    if seen.simulated:
        return SaidRow("label.clock", Sentence("clock.simulated"))
    kept = None if seen.status is None else seen.status.clock_synchronised
    if kept is None:
        return SaidRow("label.clock", Sentence("clock.system"))
    return SaidRow("label.clock", Sentence("clock.kept" if kept else "clock.free"), "good" if kept else "notice")


def _buses(status: StatusMessage) -> Iterator[SaidRow]:
    missed = {bus: n for bus, n in status.periods_missed.items() if n}
    if missed:
        yield SaidRow("label.missed", name(", ".join(f"{bus}: {n}" for bus, n in sorted(missed.items()))), "notice")
    elif status.periods_missed:
        buses = ToldName(", ".join(sorted(status.periods_missed)))
        yield SaidRow("label.buses", Sentence("buses.good", {"names": buses}), "good")


def _status(status: StatusMessage) -> Iterator[SaidRow]:
    if status.nc is not None:
        mark = _NC_MARKS.get(status.nc, "notice")
        yield SaidRow("label.nc", Sentence("sentence.word", {"word": Word(f"nc.{status.nc}")}), mark)
    storage = status.storage
    if storage is not None and storage.problem:
        waiting = Amount(storage.waiting, d=0)
        problem = in_each(text_from(storage.problem, storage.problem_coded))
        yield SaidRow("label.store", Sentence("store.problem", {"text": problem, "n": waiting}), "bad")
    elif storage is not None:
        yield SaidRow("label.store", Sentence("store.good"), "good")
    if storage is not None:
        yield _spool(storage)
    if storage is not None and storage.free_mb is not None:
        yield SaidRow("label.disk", Sentence("disk.free", {"gb": Amount(storage.free_mb / 1e3, "GB")}))
    yield from _buses(status)
    dropped = status.readings_dropped + status.messages_dropped
    if dropped:
        yield SaidRow("label.dropped", Sentence("messages.dropped", {"n": Amount(dropped, d=0)}), "notice")
    if status.uptime_s is not None:
        yield SaidRow("label.uptime", Sentence("uptime.hours", {"h": Amount(status.uptime_s / 3600.0, "h")}))
    if status.version:
        yield SaidRow("label.version", name(status.version))
    if status.config:
        yield SaidRow("label.config", name(status.config[:16]))


def _spool(storage: StorageStanding) -> SaidRow:
    """What is only in memory: with a store that works, what has come since the last commit."""
    mark = "notice" if storage.problem or storage.dropped else ""
    values: dict[str, Atom] = {"n": Amount(storage.waiting, d=0)}
    if storage.dropped:
        values["dropped"] = Amount(storage.dropped, d=0)
        return SaidRow("label.spool", Sentence("spool.dropped", values), mark)
    if not storage.waiting or storage.oldest_s is None:  # or of an earlier program
        return SaidRow("label.spool", Sentence("spool.waiting" if storage.waiting else "spool.empty", values), mark)
    values["oldest"] = Amount(storage.oldest_s, "s", d=0)
    return SaidRow("label.spool", Sentence("spool.oldest", values), mark)


@dataclass(frozen=True, slots=True)
class ShownEvent:
    """One event; a problem and its end are one."""

    t: str
    kind: str
    """Key of the catalogue."""
    said: Sentence
    mark: str
    ended: str | None = None
    """When the problem ended."""
    lasts: bool = False
    """A problem that has not ended."""
    do: Sentence | None = None
    """What to do about a problem that lasts, unless `said` tells it."""


def events(seen: MachineSeen) -> list[ShownEvent]:
    """The problems that last, then everything else; the newest first in both."""
    lasting: list[ShownEvent] = []
    others: list[ShownEvent] = []
    ends: dict[str, EventMessage] = {}
    changed: set[str] = set()
    """Subjects of which something later was said."""
    for event in reversed(seen.events):
        subject = str(event.values.get("subject", ""))
        if event.kind == EventKind.PROBLEM_ENDED and subject not in {"", *ends}:
            ends[subject] = event
        elif event.kind == EventKind.PROBLEM and subject:
            end = ends.pop(subject, None)
            lasts = end is None and subject not in changed
            shown = _shown_event(event, None if end is None else end.time)
            (lasting if lasts else others).append(replace(shown, lasts=True, do=_remedy(event)) if lasts else shown)
        else:
            others.append(_shown_event(event))
        changed.add(subject)
    others.extend(map(_shown_event, ends.values()))  # their beginning was not heard
    return [*lasting, *sorted(others, key=lambda each: each.t, reverse=True)]


def _remedy(event: EventMessage) -> Sentence | None:
    match event.values.get("subject"):
        case {"code": NoticeCode.BUS | NoticeCode.DEVICE as code, "values": {"name": str(name)}}:
            return Sentence("do.look", {"first": in_each(Text(code, name=name))})
    code, values = event.code, event.values
    while code in _AROUND:
        inner = values.get("problem")
        code, values = (str(inner.get("code")), inner.get("values") or {}) if isinstance(inner, dict) else ("", {})
    if code in TOLD_WITH_REMEDY:
        return None
    return Sentence(f"do.{code}" if f"do.{code}" in page_texts("en") else "do.call")


def _shown_event(event: EventMessage, ended: str | None = None) -> ShownEvent:
    said = told(restored(event.text, event.code, event.values) if event.code else plain(event.text))
    if ended is not None or event.kind == EventKind.PROBLEM_ENDED:
        return ShownEvent(event.time, f"event.{EventKind.PROBLEM_ENDED}", said, "good", ended)
    return ShownEvent(event.time, f"event.{event.kind}", said, mark_of(event.kind))


def mark_of(kind: str) -> str:
    """Of an event: `bad`, `notice`, or empty."""
    return "bad" if kind in _BAD else "notice" if kind in _NOTABLE else ""


def _unit(unit: str) -> str:
    return _CELSIUS if unit == "degC" else unit.replace("um", "µm") if unit.startswith("um") else unit
