"""`talc-gateway status`: the condition of a configuration's gateway, from its database and lock on this computer."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from datetime import UTC, datetime, timedelta
from pathlib import Path

from drivers.base import Quality
from gateway.config.consequences import unarmed
from gateway.config.model import GatewayConfig
from gateway.control.restart.proven import dry_run_wanted
from gateway.model.text import Language, Text, json_of, plain, values_of
from gateway.nc.problems import still_wrong
from gateway.runtime.terminal import duration_text, printable, terminal
from gateway.runtime.time_service import clock_synchronised
from gateway.service.opening import armed
from gateway.service.telemetry_watch import SUBJECT as TELEMETRY
from gateway.storage.answers import answered
from gateway.storage.history import History
from talc.frame import Event, EventKind

_RECENT = timedelta(hours=24)
_EVENTS = 8
_NEVER = datetime.max.replace(tzinfo=UTC)
_LATE_STEPS = 2
_UNREAD = "unread"


@dataclass(frozen=True, slots=True)
class Status:
    """The condition of a gateway."""

    machine: str
    running: bool
    """Whether a process holds the lock of the database."""
    phase: str | None
    decision_age_s: float | None
    """Since the end of the step that the latest decision is about."""
    armed: Text
    unarmed: tuple[Text, ...]
    paused: Text | None
    """Who has paused the compensation, and since when; None: it is not paused."""
    disarmed: Text | None
    """Who has disarmed the gateway, and since when; None: nobody."""
    readings: dict[str, tuple[float | None, str, str]]
    """Channel to the latest value of the last minutes in this run, unit and quality."""
    missing: tuple[str, ...]
    """Channels that were not read in that time, or are not good."""
    control: tuple[Text, ...]
    """What is wrong with the control now."""
    problems: tuple[tuple[datetime, Text], ...]
    """The latest problems of the last day or their ends, one of each device, channel or control, oldest first."""
    clock_synchronised: bool
    """Whether a time service has set this computer's clock."""
    well: bool
    """It runs, decides in time, every channel is good, and nothing is wrong with the control."""
    telemetry: tuple[datetime, Text] | None = None
    """Whether the telemetry is connected and to whom, or why not, and since when; None: it only listens, or is off."""
    cycle: datetime | None = None
    """Since when a probing cycle is asked for or runs; None: none. Do not restart the gateway meanwhile."""
    applied: bool = True
    """Whether the gateway runs by the configuration that is in the file; if not, reload it or restart the gateway."""


def status_of(config: GatewayConfig, now: datetime, *, synchronised: bool = True) -> Status:
    """The status at this time. Raises StoreError when the database cannot be read.

    synchronised: whether this time is known to be right
    """
    path, step_s = config.storage.path, config.grid.step_s
    channels = [channel.name for channel in config.channels]
    decision: tuple[int, str] | None = None
    lead_s = 0.0
    readings: dict[str, tuple[float | None, str, str]] = {}
    problems: tuple[tuple[datetime, Text], ...] = ()
    control: tuple[Text, ...] = ()
    of_telemetry: list[tuple[datetime, Text]] = []
    pause = disarmed = cycle = None
    applied = True
    if answered(path, path.is_file):
        with History(path) as history:
            decision = history.latest_decision()
            pause, disarmed, cycle = history.paused(), history.disarmed(), history.cycle_asked()
            in_use = history.config()
            applied = in_use is None or in_use[1] == config.fingerprint()
            if (moment := history.moment()) is not None:
                lead_s = moment.lead_s
            longest_s = max((channel.period_s for channel in config.channels), default=step_s)
            lately_s = max(step_s, 3 * longest_s + config.storage.commit_s)  # the newest are not on the disk yet
            readings = history.latest_readings(now - timedelta(seconds=lately_s))
            troubles = history.troubles()
            control = still_wrong(plain(event.text) for _, event in troubles)
            of_telemetry = [(at, plain(e.text)) for at, e in troubles if e.values.get("subject") == TELEMETRY]
            problems = _latest((at, e) for at, _, e in history.events((now - _RECENT, _NEVER)))
    usable = {quality.value for quality in Quality if quality.usable}  # a newer program may have stored other ones
    missing = tuple(name for name in channels if name not in readings or readings[name][2] not in usable)
    age_s = None if decision is None else now.timestamp() + lead_s - decision[0] * step_s
    running = _held(path)
    return Status(
        machine=config.machine.name,
        running=running,
        phase=None if decision is None else decision[1],
        decision_age_s=age_s,
        armed=armed(config),
        unarmed=tuple(filter(None, (*unarmed(config), dry_run_wanted(config)))),
        paused=None if pause is None else pause.text,
        disarmed=None if disarmed is None else disarmed.text,
        readings=readings,
        missing=missing,
        control=control if running else (),
        problems=problems,
        clock_synchronised=synchronised,
        telemetry=of_telemetry[-1] if running and of_telemetry else None,
        cycle=cycle if running else None,
        applied=applied or not running,
        well=running and age_s is not None and age_s <= _LATE_STEPS * step_s and not missing and not control,
    )


def show(config: GatewayConfig, as_json: bool, language: str = "en") -> bool:
    """Print it; True if all is well."""
    status = status_of(config, datetime.now(UTC), synchronised=clock_synchronised() is True)
    console = terminal()
    lines = [as_json_text(status)] if as_json else written(status, len(config.channels), Language(language))
    for line in lines:
        console.print(line if as_json else printable(line), soft_wrap=True, highlight=False)
    return status.well


def as_json_text(status: Status) -> str:
    """For other programs: the texts in English, and of the problems also what they say."""
    problems = [f"{at:%H:%M} {text}" for at, text in status.problems]
    told = [(at, text, *values_of(text)) for at, text in status.problems]
    coded = [{"at": at.isoformat(), "text": text, "code": code, "values": values} for at, text, code, values in told]
    control = [_told(text) for text in status.control]
    fields = {field.name: getattr(status, field.name) for field in dataclass_fields(status)}
    fields["cycle"] = None if status.cycle is None else status.cycle.isoformat()
    telemetry = (
        None if status.telemetry is None else {"since": status.telemetry[0].isoformat()} | _told(status.telemetry[1])
    )
    whole = (
        fields | {"telemetry": telemetry} | {"problems": problems, "problems_coded": coded, "control_coded": control}
    )
    return json.dumps(whole, ensure_ascii=False)


def _told(text: Text) -> dict[str, object]:
    return {"text": text, "code": text.code, "values": json_of(text.values)}


def written(status: Status, channels: int, said: Language) -> Iterator[str]:
    """Line by line, for people. channels: how many the configuration has"""
    decision = said("status.no_decision")
    if status.decision_age_s is not None:
        decision = said("status.decision", age=duration_text(status.decision_age_s))
        if status.running:
            decision = said("status.phase", phase=status.phase, decision=decision)
    yield said("status.runs" if status.running else "status.runs_not", machine=status.machine, decision=decision)
    yield from map(said.of, (status.armed, *status.unarmed))
    if status.disarmed is not None:
        yield said("status.disarmed", order=status.disarmed)
    if status.paused is not None:
        yield said("status.paused", order=status.paused)
    if status.cycle is not None:
        yield said("status.cycle", since=status.cycle)
    if not status.applied:
        yield said("status.not_applied")
    if not status.running and not status.readings:
        yield said("status.no_channels", all=channels)
    else:
        yield said("status.channels", good=channels - len(status.missing), all=channels)
        for name in status.missing:
            quality = status.readings[name][2] if name in status.readings else _UNREAD
            yield said("status.channel", name=name, state=quality)
    yield from _beside(status, said)
    if not status.clock_synchronised:
        yield said("status.clock")
    yield from (f"  {at:%H:%M} {said.of(text)}" for at, text in status.problems)


def _beside(status: Status, said: Language) -> Iterator[str]:
    """The control and the network."""
    for text in status.control:
        yield said.of(text)
        if remedy := text.about("remedy", said.code):
            yield said("status.remedy", remedy=remedy)
    if status.telemetry is not None:
        since, text = status.telemetry
        yield said("status.telemetry", text=text, since=since)


def _latest(events: Iterable[tuple[datetime, Event]]) -> tuple[tuple[datetime, Text], ...]:
    """The latest problem, or its end, of each subject: one device that comes and goes hides no other."""
    found: dict[str, tuple[datetime, Text]] = {}
    for at, event in events:
        if event.kind in (EventKind.PROBLEM, EventKind.PROBLEM_ENDED):
            subject = str(event.values.get("subject", event.text))
            found.pop(subject, None)
            found[subject] = at, plain(event.text)
    return tuple(found.values())[-_EVENTS:]


def _held(path: Path) -> bool:
    """Whether a gateway has the database's lock. Asked of the kernel: trying it could keep a gateway from starting."""
    try:
        with path.with_name(path.name + ".lock").open("rb") as lock:
            inode = os.fstat(lock.fileno()).st_ino
            opened = Path(f"/proc/self/fdinfo/{lock.fileno()}").read_text(encoding="ascii")
        mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8")
        locks = Path("/proc/locks").read_text(encoding="ascii")
    except OSError:
        return False
    return is_locked(locks, file_system_of(opened, mounts), inode)


def file_system_of(opened: str, mounts: str) -> str:
    """Major and minor number of the file system of an open file, as /proc/locks has them; empty: not known.

    `stat` has others on file systems with their own volumes.

    Parameters
    ----------
    opened: of /proc/self/fdinfo
    mounts: of /proc/self/mountinfo
    """
    (mount,) = (line.split()[1] for line in opened.splitlines() if line.startswith("mnt_id:"))
    for line in mounts.splitlines():
        number, _, numbers, *_ = line.split()
        if number == mount:
            return ":".join(f"{int(one):02x}" for one in numbers.split(":"))
    return ""


def is_locked(locks: str, device: str, inode: int) -> bool:
    """Whether a whole file is locked, by the text of /proc/locks: files on two disks may have the same number."""
    return any("FLOCK" in line and f"{device}:{inode} " in line for line in locks.splitlines())
