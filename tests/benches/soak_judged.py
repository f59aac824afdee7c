"""Judges a soak by the database, by the machine's list of faults, and by what was seen from outside."""

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from gateway.config.model import GatewayConfig
from gateway.storage.history import History
from talc.frame import Event, EventKind
from tests.benches.faulty_machine import WIRES

SURPRISE = "a second cycle must give the same result"
"""Ends the text of a rejection that awaits confirmation (gateway/nc/probing/checks.py)."""
ALARMS = (EventKind.PROBLEM, EventKind.MEASUREMENT_REJECTED, EventKind.SENSOR_SUSPECT, EventKind.MODEL_REJECTED)
LEAST_GROWTH = 2
"""Descriptors, threads or tasks by which two medians may differ: a commit or a closing connection changes each for a
moment."""
LEARNT_MB, RECORDED_MB_PER_DAY = 40.0, 0.5
"""Memory by which they may differ: what the service takes in its first days until it has learnt (27 MB between the
thirds of four days), and what the emulators write down of what they do (84 MB between those of a year)."""

CONTROL = "NC"
"""Its wire, and how messages about its connection begin (gateway/nc)."""
HELD = {"descriptors": "descriptors", "threads": "threads", "tasks": "tasks", "memory, MB": "resident_mb"}


@dataclass(frozen=True, slots=True)
class HeldNow:
    """What the process has open at one moment."""

    descriptors: int
    threads: int
    tasks: int
    resident_mb: float


@dataclass(frozen=True, slots=True)
class SoakRun:
    """One run of the service: begin and end, simulated s, and what the process held at its end and after it."""

    begin_s: float
    end_s: float
    properly: bool
    working: HeldNow
    resting: HeldNow


@dataclass(slots=True)
class SoakSeen:
    """What was seen from outside the database."""

    real_s: float = 0.0
    runs: list[SoakRun] = field(default_factory=list)
    lags_s: list[float] = field(default_factory=list)
    """From the end of a grid step to its decision, simulated s."""
    readings: int = 0
    """Readings that the store was given."""
    changes_um: dict[str, float] = field(default_factory=dict)
    """Of the offsets from one write to the next, the largest: within a run, and from one run to the next."""
    slew_um: float = 0.0
    """What the configuration allows in one period."""
    children: int = 0
    """Child processes left at the end."""


@dataclass(frozen=True, slots=True)
class SoakFault:
    """One fault of the machine; infinite while it lasts."""

    name: str
    begin_s: float
    end_s: float = float("inf")

    @property
    def wire(self) -> str:
        """The bus, or NC."""
        return WIRES[self.name]


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that the gateway reported, or the end of it."""

    at_s: float
    kind: EventKind
    text: str


@dataclass(frozen=True, slots=True)
class SoakResult:
    """The table, and what counts against the gateway."""

    rows: Sequence[tuple[str, str]]
    lost: int
    missed: Sequence[SoakFault]
    false: Sequence[Alarm]
    asked_again: Sequence[Alarm]
    """Surprising probing results that the next cycle explained: each cost two minutes, and nobody had to act."""
    leaks: Sequence[str]
    """What grew by more than it may."""
    stepped: bool

    @property
    def good(self) -> bool:
        """Nothing was lost, missed, reported without cause, leaked, or stepped."""
        return not (self.lost or self.missed or self.false or self.leaks or self.stepped)


def judged(folder: Path, config: GatewayConfig, epoch: datetime, seen: SoakSeen) -> SoakResult:
    """Judge a soak that has ended."""
    with History(config.storage.path) as history:
        stored = [step.frame.k for step in history.steps()]
        found = [(at, event) for at, _, event in history.events()]
        kept = sum(sum(counts.values()) for counts in history.channel_health().values())
        probed = [((m.ended - epoch).total_seconds(), m.errors is not None) for m in history.measurements()]
    alarms = alarms_of(found, epoch)
    faults = faults_of((folder / "faults.jsonl").read_text("utf-8").splitlines())
    begins_s = [run.begin_s for run in seen.runs]
    words = words_of(config)
    unexplained = false_alarms(alarms, faults, begins_s, words)
    again = asked_again(unexplained, probed, begins_s)
    false = [alarm for alarm in unexplained if alarm not in again]
    missed = [f for f in _whole(faults, seen.runs) if not reported(f, alarms, words)]
    due = _due(seen.runs, epoch, config.grid.step_s)
    lost = len(due - set(stored))
    within, across = (seen.changes_um.get(name, 0.0) for name in ("within", "across"))
    thinned = seen.runs[-1].end_s > config.storage.keep_samples_days * 86400.0
    counted = Counter(fault.name for fault in faults)
    ends = _ends_seen_s(faults, alarms, begins_s, words)
    improper = sum(not run.properly for run in seen.runs[:-1])
    rows = [
        ("simulated time", _durations(seen)),
        ("faults", "; ".join(f"{name}: {count}" for name, count in sorted(counted.items()))),
        ("restarts", f"{len(seen.runs) - 1}, of which {improper} by cancelling the service"),
        ("grid steps: expected, lost, stored twice", f"{len(due)}, {lost}, {len(stored) - len(set(stored))}"),
        ("readings: taken, stored", f"{seen.readings}, {'thinned to minutes by then' if thinned else kept}"),
        ("faults within one run that were not reported", f"{len(missed)} of {len(_whole(faults, seen.runs))}"),
        ("end of a fault until it is reported", _shares_s(ends)),
        ("alarms: false, all", f"{len(false)}, {sum(a.kind in ALARMS for a in alarms)}"),
        ("cycles of probing, and surprises that the next one explained", f"{len(probed)}, {len(again)}"),
        ("decision after the end of its grid step", _shares_s(seen.lags_s)),
        ("largest change of the offsets in a period: within a run, across a restart, allowed",
         f"{within:.1f}, {across:.1f}, {seen.slew_um:.1f} µm"),
        *((f"{name}, at the end of the runs and between them: first and last third",
           f"{_both(seen.runs, _held('working', what))}; {_both(seen.runs, _held('resting', what))}")
          for name, what in HELD.items()),
        ("child processes left", str(seen.children)),
    ]  # fmt: skip
    lost += 0 if thinned else seen.readings - kept
    leaks = leaks_of(seen.runs, seen.children)
    return SoakResult(rows, lost, missed, false, again, leaks, max(within, across) > seen.slew_um * (1 + 1e-9))


def leaks_of(runs: Sequence[SoakRun], children: int) -> list[str]:
    """What grew by more than allowed from the first third of the runs to the last, and processes that were left."""
    days = (runs[-1].end_s - runs[0].begin_s) / 86400.0
    memory_mb = LEARNT_MB + RECORDED_MB_PER_DAY * days
    found = [f"{children} child processes"] if children else []
    for when, told in (("working", "at the end of the runs"), ("resting", "between the runs")):
        for name, what in HELD.items():
            early, late = _thirds(runs, _held(when, what))
            most = memory_mb if what == "resident_mb" else LEAST_GROWTH
            if late - early > most:
                found.append(f"{name}, {told}: from {early:.0f} to {late:.0f}, which is more than {most:.0f}")
    return found


def alarms_of(found: Sequence[tuple[datetime, Event]], epoch: datetime) -> list[Alarm]:
    """Stored events that are alarms, or ends of them."""
    kinds = (*ALARMS, EventKind.PROBLEM_ENDED)
    return [Alarm((at - epoch).total_seconds(), e.kind, e.text) for at, e in found if e.kind in kinds]


def faults_of(lines: Sequence[str]) -> list[SoakFault]:
    """The machine's list: a line for each begin and each end, one fault at a time."""
    faults: list[SoakFault] = []
    for line in lines:
        entry = json.loads(line)
        if "begin_s" in entry:
            faults.append(SoakFault(entry["fault"], entry["begin_s"]))
        else:
            faults[-1] = SoakFault(entry["fault"], faults[-1].begin_s, entry["end_s"])
    return faults


def words_of(config: GatewayConfig) -> dict[str, re.Pattern[str]]:
    """For each wire, what an alarm about it names: the bus, its devices, their channels; the control and probing."""
    named = {CONTROL: ["NC", "nc", "probing", "control"]}
    for bus in config.buses:
        devices = [device for device in config.devices if device.bus == bus.name]
        named[bus.name] = [bus.name, *(d.name for d in devices), *(c for d in devices for c in d.channels)]
    return {wire: re.compile(rf"\b({'|'.join(names)})\b") for wire, names in named.items()}


def false_alarms(
    alarms: Sequence[Alarm],
    faults: Sequence[SoakFault],
    begins_s: Sequence[float],
    words: Mapping[str, re.Pattern[str]],
) -> list[Alarm]:
    """Alarms that no fault explains.

    A fault explains an alarm that names its wire, from its begin until the gateway has reported that it is over. The
    gateway cannot know that before it asks again, and a breaker doubles the pause between two questions: for up to as
    long as the fault has lasted. After a restart the service asks at once, so nothing before it explains anything.
    """
    spans = [(f, explained_until_s(f, alarms, begins_s, words)) for f in faults]
    return [
        alarm
        for alarm in alarms
        if alarm.kind in ALARMS
        and not any(f.begin_s <= alarm.at_s <= until and words[f.wire].search(alarm.text) for f, until in spans)
    ]


def asked_again(
    alarms: Sequence[Alarm], probed: Sequence[tuple[float, bool]], begins_s: Sequence[float]
) -> list[Alarm]:
    """Alarms that only ask for a second cycle, where the next one's result was used.

    A machine that has just begun to move differs from what a gateway that never saw it move predicts. Asking again is
    right then: dirt in the probe's taper looks the same. It is false when the next result is rejected as well, unless
    the service was restarted in between, as it then knows nothing of the first.

    probed: when each cycle ended, simulated s, and whether its result was used; oldest first
    """
    found = []
    for alarm in alarms:
        until_s = min((begin for begin in begins_s if begin > alarm.at_s), default=float("inf"))
        later = [used for at_s, used in probed if alarm.at_s < at_s < until_s]
        surprise = alarm.kind is EventKind.MEASUREMENT_REJECTED and alarm.text.endswith(SURPRISE)
        if surprise and (not later or later[0]):
            found.append(alarm)
    return found


def explained_until_s(
    fault: SoakFault, alarms: Sequence[Alarm], begins_s: Sequence[float], words: Mapping[str, re.Pattern[str]]
) -> float:
    """When the gateway knew that the fault was over: it said so, or it started again."""
    ended = _ended_s(fault, alarms, words)
    return min([*ended, *(begin for begin in begins_s if begin >= fault.end_s)], default=float("inf"))


def reported(fault: SoakFault, alarms: Sequence[Alarm], words: Mapping[str, re.Pattern[str]]) -> bool:
    """Whether an alarm named the fault's wire while it lasted, or one from before it had not ended."""
    about = [a for a in alarms if words[fault.wire].search(a.text) and a.at_s <= fault.end_s]
    return any(a.kind in ALARMS and a.at_s >= fault.begin_s for a in about) or (
        bool(about) and about[-1].kind is EventKind.PROBLEM
    )


def _ended_s(fault: SoakFault, alarms: Sequence[Alarm], words: Mapping[str, re.Pattern[str]]) -> list[float]:
    """When the gateway said that it is over. Of the control, only the end of what it says of the connection counts:
    while that is not there, probing may be blocked by it, wanted no more, and wanted and blocked again."""
    said = [a for a in alarms if a.kind is EventKind.PROBLEM_ENDED and a.at_s >= fault.end_s]
    if fault.wire == CONTROL:
        return [a.at_s for a in said if a.text.startswith(f"{CONTROL}:")]
    return [a.at_s for a in said if words[fault.wire].search(a.text)]


def _ends_seen_s(
    faults: Sequence[SoakFault],
    alarms: Sequence[Alarm],
    begins_s: Sequence[float],
    words: Mapping[str, re.Pattern[str]],
) -> list[float]:
    """How long after the end of a fault its end was reported, where no restart came between."""
    found = []
    for fault in faults:
        until = explained_until_s(fault, alarms, begins_s, words)
        if until in _ended_s(fault, alarms, words):
            found.append(until - fault.end_s)
    return found


def _whole(faults: Sequence[SoakFault], runs: Sequence[SoakRun]) -> list[SoakFault]:
    return [f for f in faults if any(run.begin_s <= f.begin_s and f.end_s <= run.end_s for run in runs)]


def _due(runs: Sequence[SoakRun], epoch: datetime, step_s: float) -> set[int]:
    """Indices of the grid steps that a run of the service saw from begin to end."""
    base = epoch.timestamp()
    return {
        k
        for run in runs
        for k in range(int((base + run.begin_s) // step_s) + 2, int((base + run.end_s - 60.0) // step_s) + 1)
    }


def _durations(seen: SoakSeen) -> str:
    simulated, real = (timedelta(seconds=round(s)) for s in (seen.runs[-1].end_s, seen.real_s))
    return f"{simulated}, in {real}"


def _shares_s(times_s: Sequence[float]) -> str:
    if not times_s:
        return "none"
    middle, most, longest = np.quantile(times_s, [0.5, 0.99, 1.0])
    return f"median {middle:.1f} s, 99 % within {most:.1f} s, longest {longest:.1f} s"


def _held(when: str, what: str) -> Callable[[SoakRun], float]:
    return lambda run: float(getattr(getattr(run, when), what))


def _thirds(runs: Sequence[SoakRun], value: Callable[[SoakRun], float]) -> tuple[float, float]:
    """Medians of the first and of the last third, without the first run: what is loaded once is loaded then."""
    values = [value(run) for run in (runs[1:] or runs)]
    third = max(1, len(values) // 3)
    return float(np.median(values[:third])), float(np.median(values[-third:]))


def _both(runs: Sequence[SoakRun], value: Callable[[SoakRun], float]) -> str:
    early, late = _thirds(runs, value)
    return f"{early:.0f} and {late:.0f}"
