"""The report's data, read from a database and, for a simulation, from the file of its true errors."""

import csv
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np

from gateway.config.model import GatewayConfig
from gateway.model.compensation import Source
from gateway.model.text import Language
from gateway.reporting.data import TRUTH_WIDTH, WORK_SHIFTS, AdoptedModels, CycleSeen, NotYet, ReportData, Truth
from gateway.reporting.local import local_moment
from gateway.reporting.page import nothing_learnt, nothing_that_day
from gateway.storage.configurations import stored_config
from gateway.storage.faults import StoreError
from gateway.storage.history import History, TimeSpan
from gateway.storage.stored import StoredMeasurement, StoredStep
from talc.explanation import Reasons
from talc.frame import FloatArray, Phase
from talc.names import THERMAL_ERRORS

_DAY = timedelta(days=1)
_LAST_K = 2**63 - 1
_WITHOUT_PREDICTION = frozenset({Source.STALE, Source.INPUTS_STALE, Source.NO_MODEL, Source.NOT_STORED})


@dataclass(frozen=True, slots=True)
class Reader:
    """Where and when the page is read."""

    zone: tzinfo | None = None
    """None: the time zone of this computer."""
    shifts: tuple[time, ...] = WORK_SHIFTS
    """When they begin; none: no shifts."""
    day: date | None = None
    """Only this one, from midnight to midnight in the zone; None: all that is stored."""
    language: str = "en"
    """Of the catalogue."""
    tolerance_um: float | None = None
    """Of the jobs; None: nobody has said."""

    @property
    def within(self) -> TimeSpan | None:
        """The day in UTC: an hour shorter or longer when the clocks change."""
        if self.day is None:
            return None
        zone = self.zone or own_zone()
        begin, end = (datetime.combine(day, time(), zone).astimezone(UTC) for day in (self.day, self.day + _DAY))
        return begin, end


def empty_page(database: Path, reader: Reader) -> str | None:
    """The page that says why there is nothing to report; None: there is something. Raises StoreError."""
    said = Language(reader.language)
    with History(database) as history:
        if history.config() is None:
            return nothing_learnt(database.name, [NotYet("run")], said)
        config = stored_config(history)
        first, last = history.span()
        if first is None or last is None:
            return nothing_learnt(config.machine.name, not_yet(history, config, (), history.channel_health()), said)
        if reader.day is None:
            return None
        after, until = _steps_within(reader.within, config.grid.step_s)
        if any(True for _ in history.steps(after, last_k=until)):
            return None
        zone = reader.zone or own_zone()
        begin, end = (local_moment(k * config.grid.step_s, zone, said) for k in (first, last))
        return nothing_that_day(config.machine.name, reader.day, begin, end, said)


def collect(database: Path, truth: Path | None = None, reader: Reader | None = None) -> ReportData:
    """All that the report shows, as arrays. Times are seconds since the first frame's instant.

    Raises StoreError: it holds no frame.
    """
    reader = reader or Reader()
    within = reader.within
    with History(database) as history:
        config, found = stored_config(history), history.config()
        names, step_s = config.input_names, config.grid.step_s
        after, until = _steps_within(within, step_s)
        steps = list(history.steps(after, names, until))
        if not steps or found is None:
            raise StoreError(f"{database}: contains no frames yet")
        k = np.array([s.frame.k for s in steps])
        start = float(k[0]) * step_s
        nothing = np.full(9, np.nan)
        compensation = history.compensation(within)
        cycles = history.measurements(within)
        units = history.units()
        # Of a day the steps are counted: there is no index by time on millions of readings.
        health = _all_channels(history, config) if within is None else _steps_good(steps, names)
        reference = history.reference()
        earlier = within is not None and reference is not None and reference.ended < within[0]
        return ReportData(
            machine=config.machine.name,
            fingerprint=found[1],
            versions=found[2],
            step_s=step_s,
            start_utc_s=start,
            k=k,
            phases=tuple(s.decision.phase for s in steps),
            predicted=np.array([s.decision.predicted for s in steps]),
            corrected=np.array([s.decision.corrected for s in steps]),
            sigma=np.array([s.decision.sigma for s in steps]),
            limits=np.array([s.decision.limits for s in steps]),
            measured=np.array([s.frame.measurement.errors if s.frame.measurement else nothing for s in steps]),
            models=tuple(AdoptedModels(s.frame.k, m) for s in steps for m in s.adopted),
            events=tuple((at.timestamp() - start, event) for at, _, event in history.events(within)),
            compensation_s=np.array([c.time.timestamp() - start for c in compensation]),
            compensation_um=np.array([c.offsets_um for c in compensation]).reshape(-1, 3),
            input_names=names,
            channel_health=health,
            health_of="readings" if within is None else "steps",
            language=reader.language,
            cycles=len(cycles),
            rejected_cycles=sum(m.errors is None for m in cycles),
            truth=None if truth is None else _truth(truth, start),
            trusted=np.array([s.decision.trusted for s in steps]) if all(s.trust_known for s in steps) else None,
            reasons=history.reasons(until),
            compared=config.sensor_check.enabled,
            zone=reader.zone or own_zone(),
            shifts=reader.shifts,
            noise=_noise(steps),
            inputs=np.array([np.where(s.frame.valid, s.frame.inputs, np.nan) for s in steps]),
            input_units=tuple(units.get(name, "") for name in names),
            moved=_moved(history.reasons_given(after, until), names),
            cycles_seen=_cycles(cycles, start, 1 if earlier else config.probing.reference_cycles),
            stale=np.array([c.source in _WITHOUT_PREDICTION for c in compensation], dtype=np.bool_),
            sphere_m=(config.probing.sphere_radius_mm * 1e-3, config.probing.sphere_height_mm * 1e-3),
            mode=config.compensation.mode,
            tolerance_um=reader.tolerance_um or _stated(steps),
            instruments=tuple(
                (each.what, each.serial, _day(each.calibrated), _day(each.due)) for each in config.instruments
            ),
            not_yet=() if earlier else not_yet(history, config, steps, health),
        )


def _stated(steps: Sequence[StoredStep]) -> float | None:
    """The tolerance, µm, that part programs stated last; None: none did."""
    return next((um for step in reversed(steps) if (um := step.frame.tolerance_um)), None)


def _day(day: date | None) -> str:
    return "" if day is None else day.isoformat()


def _steps_within(within: TimeSpan | None, step_s: float) -> tuple[int, int]:
    """The grid index before the first one of a span, and the last one: a step belongs to the time before its end."""
    if within is None:
        return -1, _LAST_K
    before, last = (math.floor(at.timestamp() / step_s) for at in within)
    return before, last


def _steps_good(steps: Sequence[StoredStep], names: Sequence[str]) -> dict[str, dict[str, int]]:
    """By input: the number of steps with and without a good value."""
    good = np.sum([s.frame.valid for s in steps], axis=0).tolist()
    return {
        name: {"good": n, **({"not_good": len(steps) - n} if n < len(steps) else {})}
        for name, n in zip(names, good, strict=True)
    }


def _all_channels(history: History, config: GatewayConfig) -> Mapping[str, Mapping[str, int]]:
    """The readings of each channel by quality, also of those that were never read."""
    return {channel.name: {} for channel in config.channels} | history.channel_health()


def not_yet(
    history: History, config: GatewayConfig, steps: Sequence[StoredStep], health: Mapping[str, Mapping[str, int]]
) -> tuple[NotYet, ...]:
    """What is missing before the gateway can learn, in the order in which it comes; empty: it has learnt."""
    if any(step.frame.measurement is not None for step in steps):
        done = sum(step.decision.phase is Phase.CALIBRATION for step in steps)
        if done < len(steps):
            return ()
        return (NotYet("calibration", {"done": done, "of": config.talc.control.calibration_steps}),)
    found: list[NotYet] = []
    if not steps:
        found.append(NotYet("step", {"minutes": config.grid.step_s / 60.0}))
    silent = _silent(health, [channel.name for channel in config.channels])
    if silent:
        found.append(NotYet("reading", {"channels": silent}))
    if config.nc is None:
        found.append(NotYet("control"))
    elif not config.probing.armed:
        found.append(NotYet("probing"))
    return (*found, *_not_measured(history, config.probing.reference_cycles))


def _not_measured(history: History, wanted: int) -> Iterable[NotYet]:
    cycles = history.measurements()
    used = [cycle for cycle in cycles if not cycle.reason]
    if not cycles:
        yield NotYet("measurement")
    elif not used:
        yield NotYet("used", {"n": len(cycles), "last": cycles[-1].reason})
    yield NotYet("reference", {"n": wanted})


def _cycles(measurements: Sequence[StoredMeasurement], start: float, reference: int) -> tuple[CycleSeen, ...]:
    """The first that was used is the reference: several cycles, one after the other."""
    first = next((i for i, m in enumerate(measurements) if not m.reason), None)
    return tuple(
        CycleSeen(
            m.ended.timestamp() - start,
            m.reason,
            reference if i == first else 1,
            (m.ended - m.asked).total_seconds() or math.nan,  # of a reference from elsewhere nothing is known
        )
        for i, m in enumerate(measurements)
    )


def _silent(health: Mapping[str, Mapping[str, int]], channels: Sequence[str]) -> list[str]:
    return [name for name in channels if not health.get(name, {}).get("good")]


def own_zone(link: Path = Path("/etc/localtime")) -> tzinfo:
    """The time zone of this computer: `TZ`, or where Linux' link leads; both know daylight saving. Else UTC."""
    _, _, linked = str(link.resolve()).partition("/zoneinfo/")
    for name in (os.environ.get("TZ", "").removeprefix(":"), linked):
        try:
            if name:
                return ZoneInfo(name)
        except (LookupError, ValueError, OSError):  # a rule such as CET-1CEST, or another layout: the next way
            continue
    return UTC


def _noise(steps: Sequence[StoredStep]) -> FloatArray:
    """(9,) median standard uncertainty of the measurements; NaN where none is known."""
    known = [step.frame.measurement.sigma for step in steps if step.frame.measurement is not None]
    sigma = np.array(known).reshape(-1, len(THERMAL_ERRORS))
    told = np.isfinite(sigma).any(axis=0)
    found = np.full(len(THERMAL_ERRORS), np.nan)
    found[told] = np.nanmedian(sigma[:, told], axis=0)
    return found


def _moved(given: Iterable[Reasons], names: Sequence[str]) -> FloatArray | None:
    """(9, n) mean over all stored reasons of the magnitude by which each input moved each error."""
    at, total, many = {name: i for i, name in enumerate(names)}, np.zeros((len(THERMAL_ERRORS), len(names))), 0
    for reasons in given:
        many += 1
        for e, reason in enumerate(reasons.errors):
            for name, value in reason.inputs:
                if name in at and np.isfinite(value):
                    total[e, at[name]] += abs(value)
    return total / many if many else None


def _truth(path: Path, start_utc_s: float) -> Truth:
    """The emulated machine's own record, whose last line may be truncated, on the report's time axis."""
    with path.open(newline="", encoding="ascii") as file:
        rows = list(csv.reader(file))[1:]
    values: FloatArray = np.array([[float(v) for v in row] for row in rows if len(row) == TRUTH_WIDTH])
    return Truth.of(values, start_utc_s)
