"""`talc-gateway status`: the condition of a configuration's gateway, from its database and lock on this computer."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from drivers.base import Quality
from gateway.config.consequences import unarmed
from gateway.config.model import GatewayConfig
from gateway.control.restart.proven import dry_run_wanted
from gateway.model.text import plain
from gateway.nc.problems import still_wrong
from gateway.runtime.terminal import duration_text, printable, terminal
from gateway.runtime.time_service import clock_synchronised
from gateway.service.opening import armed
from gateway.storage.answers import answered
from gateway.storage.history import History
from talc.frame import Event, EventKind

_RECENT = timedelta(hours=24)
_EVENTS = 8
_NEVER = datetime.max.replace(tzinfo=UTC)
_LATE_STEPS = 2
_CLOCK = "the computer's clock is not synchronised: times and ages may be wrong"


@dataclass(frozen=True, slots=True)
class Status:
    """The condition of a gateway."""

    machine: str
    running: bool
    """Whether a process holds the lock of the database."""
    phase: str | None
    decision_age_s: float | None
    """Since the end of the step that the latest decision is about."""
    armed: str
    unarmed: tuple[str, ...]
    paused: str | None
    """Who has paused the compensation, and since when; None: it is not paused."""
    disarmed: str | None
    """Who has disarmed the gateway, and since when; None: nobody."""
    readings: dict[str, tuple[float | None, str, str]]
    """Channel to the latest value of the last minutes in this run, unit and quality."""
    missing: tuple[str, ...]
    """Channels that were not read in that time, or are not good."""
    control: tuple[str, ...]
    """What is wrong with the control now."""
    problems: tuple[str, ...]
    """The latest problems of the last day or their ends, one of each device, channel or control, oldest first."""
    clock_synchronised: bool
    """Whether a time service has set this computer's clock."""
    well: bool
    """It runs, decides in time, every channel is good, and nothing is wrong with the control."""


def status_of(config: GatewayConfig, now: datetime, *, synchronised: bool = True) -> Status:
    """The status at this time. Raises StoreError when the database cannot be read.

    synchronised: whether this time is known to be right
    """
    path, step_s = config.storage.path, config.grid.step_s
    channels = [channel.name for channel in config.channels]
    decision: tuple[int, str] | None = None
    lead_s = 0.0
    readings: dict[str, tuple[float | None, str, str]] = {}
    problems: tuple[str, ...] = ()
    control: tuple[str, ...] = ()
    pause = disarmed = None
    if answered(path, path.is_file):
        with History(path) as history:
            decision = history.latest_decision()
            pause, disarmed = history.paused(), history.disarmed()
            if (moment := history.moment()) is not None:
                lead_s = moment.lead_s
            longest_s = max((channel.period_s for channel in config.channels), default=step_s)
            readings = history.latest_readings(now - timedelta(seconds=max(step_s, 3 * longest_s)))
            control = still_wrong(plain(event.text) for _, event in history.troubles())
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
        well=running and age_s is not None and age_s <= _LATE_STEPS * step_s and not missing and not control,
    )


def show(config: GatewayConfig, as_json: bool) -> bool:
    """Print it; True if all is well."""
    status = status_of(config, datetime.now(UTC), synchronised=clock_synchronised() is True)
    console = terminal()
    if as_json:
        console.print(json.dumps(asdict(status), ensure_ascii=False), soft_wrap=True, highlight=False)
        return status.well
    lines = [
        f"{status.machine}: {'runs' if status.running else 'IS NOT RUNNING'}, {_decision(status)}",
        status.armed,
        *status.unarmed,
        *(() if status.disarmed is None else (f"the gateway is {status.disarmed}",)),
        *(() if status.paused is None else (f"the compensation is {status.paused}",)),
        *_channels(status, len(config.channels)),
        *status.control,
        *(() if status.clock_synchronised else (_CLOCK,)),
        *(f"  {text}" for text in status.problems),
    ]
    for line in lines:
        console.print(printable(line), soft_wrap=True, highlight=False)
    return status.well


def _latest(events: Iterable[tuple[datetime, Event]]) -> tuple[str, ...]:
    """The latest problem, or its end, of each subject: one device that comes and goes hides no other."""
    found: dict[str, str] = {}
    for at, event in events:
        if event.kind in (EventKind.PROBLEM, EventKind.PROBLEM_ENDED):
            subject = str(event.values.get("subject", event.text))
            found.pop(subject, None)
            found[subject] = f"{at:%H:%M} {event.text}"
    return tuple(found.values())[-_EVENTS:]


def _decision(status: Status) -> str:
    if status.decision_age_s is None:
        return "no decision yet"
    age = f"last decision {duration_text(status.decision_age_s)} ago"
    return f"{status.phase}, {age}" if status.running else age


def _channels(status: Status, count: int) -> Iterator[str]:
    if not status.running and not status.readings:
        yield f"channels: none of {count} is read"
        return
    yield f"channels: {count - len(status.missing)} of {count} good"
    for name in status.missing:
        yield f"  {name}: {_reading(status, name)}"


def _reading(status: Status, name: str) -> str:
    return status.readings[name][2] if name in status.readings else "not read lately"


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
