"""`talc-gateway doctor`: what is wrong around the gateway on this computer, why it matters, and what to do."""

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path

import numpy as np

from drivers.can.settings import CanInterfaceSettings
from gateway.commissioning.doctor.credential_files import spoilt_file, unread_files
from gateway.commissioning.doctor.kernel_files import kernel_text
from gateway.commissioning.doctor.power import power
from gateway.config.model import GatewayConfig
from gateway.config.rules import cautions
from gateway.config.telemetry_rules import credential_problems
from gateway.control.restart.proven import dry_run_wanted
from gateway.model.codes import NoticeCode
from gateway.model.text import NOTHING, Text, plain
from gateway.runtime.terminal import terminal
from gateway.runtime.time_service import clock_synchronised
from gateway.storage.answers import answered
from gateway.storage.history import History
from talc.frame import FloatArray
from talc.steps import DAY_S, steps_in

_SCATTER_CYCLES = 10
_SCATTER_GROWN = 2.0
_MASTER = "/dev/ptmx"
"""The other end of a pseudo-terminal."""
_SAME_K = 0.02
_MOVED_K = 0.5


@dataclass(frozen=True, slots=True)
class HealthFinding:
    """One thing that is wrong."""

    what: str
    why: str
    remedy: str


_CLOCK = HealthFinding(
    "the clock is not synchronised: no time service has set it",
    "the grid and everything stored use the computer's time; a Pi without a battery-backed clock starts in the past, "
    "and after a restart the age of the last measurement is unknown",
    "install chrony and give it a server of the plant (docs/install-pi.md)",
)


_OF_OTHERS = (
    "not looked at: which programs of other users have a serial line of this configuration open; only root can see that"
)


def show(config: GatewayConfig, root: Path = Path("/"), *, sees_all: bool | None = None) -> bool:
    """Print every finding, and what this user cannot see; True if there is no finding.

    root: where /sys, /proc and /run are
    sees_all: whether this user sees the open files of all users' processes; None: root does
    """
    console = terminal()
    if sees_all is None:
        sees_all = os.geteuid() == 0
    found = list(health_findings(config, root, synchronised=clock_synchronised() is True))
    for finding in found:
        console.print(
            f"{finding.what}\n  why it matters: {finding.why}\n  what to do: {finding.remedy}", soft_wrap=True
        )
    if not found:
        console.print("nothing found")
    if not sees_all and any(bus.serial_path for bus in config.buses):
        console.print(_OF_OTHERS, soft_wrap=True)
    return not found


def health_findings(config: GatewayConfig, root: Path, *, synchronised: bool) -> Iterator[HealthFinding]:
    """Everything that is wrong, the computer first.

    synchronised: whether a time service has set this computer's clock
    """
    if not synchronised:
        yield _CLOCK
    yield from _disk(config)
    yield from (HealthFinding(*told) for told in power(root))
    yield from _can(config, root)
    yield from _other_programs(config, root)
    unread = {found.field: found for found in unread_files(config)}
    for found in unread.values():
        yield HealthFinding(found.what, found.why, found.remedy)
    for caution in cautions(config):
        if caution.where not in unread:
            yield HealthFinding(
                str(caution), "it works now and may fail later", "change it in the configuration, or renew the file"
            )
    for problem in credential_problems(config.telemetry, datetime.now(UTC)):
        if problem.where not in unread:
            yield HealthFinding(str(problem), *spoilt_file(config, problem))
    if why := dry_run_wanted(config):
        yield HealthFinding(
            why,
            "a cycle that was never driven at this machine may touch what it must not",
            "do it with the feed override at hand: docs/machine-responsible.md",
        )
    if answered(config.storage.path, config.storage.path.is_file):
        with History(config.storage.path) as history:
            yield from _other_masters(history, config)
            yield from _scatter(history.residuals_um())
            yield from _too_equal(history, config)


def _disk(config: GatewayConfig) -> Iterator[HealthFinding]:
    folder = config.storage.path.parent
    if not folder.is_dir():
        yield HealthFinding(
            f"{folder} does not exist", "the database belongs there", "create it, or change [storage] path"
        )
        return
    free = os.statvfs(folder)
    free_mb = free.f_bavail * free.f_frsize / 1e6
    if free_mb < config.storage.warn_free_mb:
        yield HealthFinding(
            f"{free_mb:.0f} MB are free on the disk of {folder}, less than {config.storage.warn_free_mb:g}",
            "on a full disk nothing is stored, and the compensation ends",
            "delete something, or lower [storage] keep_samples_days",
        )


def _can(config: GatewayConfig, root: Path) -> Iterator[HealthFinding]:
    for bus in config.buses:
        settings: object = bus  # of any family
        if not isinstance(settings, CanInterfaceSettings) or settings.interface != "socketcan":
            continue
        channel = settings.channel
        state = kernel_text(root / "sys/class/net" / channel / "operstate")
        why = f"bus '{bus.name}' cannot be read"
        if not state:
            yield HealthFinding(f"there is no interface {channel}", why, "is the adapter plugged in? ip -details link")
        elif state == "down" and _is_up(root, channel):
            yield HealthFinding(
                f"{channel} is up and has left the bus (bus-off), or has no carrier",
                why,
                "check bit rate, termination (60 ohm between CAN_H and CAN_L) and whether another node is on;"
                " restart-ms 100 lets it return by itself: deploy/pi/80-can.network",
            )
        elif state == "down":
            up = f"ip link set {channel} up type can bitrate {settings.bitrate} restart-ms 100"
            yield HealthFinding(f"{channel} is down", why, f"{up}; at every start: deploy/pi/80-can.network")


def _is_up(root: Path, interface: str) -> bool:
    """Whether somebody has switched it on (IFF_UP)."""
    flags = kernel_text(root / "sys/class/net" / interface / "flags")
    return flags.startswith("0x") and bool(int(flags, 16) & 1)


def _other_programs(config: GatewayConfig, root: Path) -> Iterator[HealthFinding]:
    """Serial ports that several processes have open."""
    ports = {os.path.realpath(line[1]): bus.name for bus in config.buses if (line := bus.serial_path)}
    users: dict[str, set[str]] = {}
    for process in (root / "proc").glob("[0-9]*"):
        opened = set(_open_files(process))
        for target in opened & ports.keys():
            if not (target.startswith("/dev/pts/") and _MASTER in opened):  # `play` is the devices, not a second master
                users.setdefault(target, set()).add(process.name)
    for port, processes in users.items():
        if len(processes) > 1:
            yield HealthFinding(
                f"bus '{ports[port]}': {port} is open in {len(processes)} processes: {_named(root, processes)}",
                "two masters on one line destroy each other's answers",
                "end the other program; only the gateway may read the line",
            )


def _named(root: Path, processes: Iterable[str]) -> str:
    found = ((number, kernel_text(root / "proc" / number / "comm")) for number in sorted(processes, key=int))
    return ", ".join(f"{number} ({name})" if name else number for number, name in found)


def _open_files(process: Path) -> Iterator[str]:
    """What a process has open; it may end while it is listed, or belong to another user."""
    with suppress(OSError):
        for link in (process / "fd").iterdir():
            with suppress(OSError):
                yield str(link.readlink())


def _other_masters(history: History, config: GatewayConfig) -> Iterator[HealthFinding]:
    """Buses on which the gateway hears another master, by the last event of each."""
    last: dict[str, Text] = {}
    for _, _, event in history.events():
        text = plain(event.text)
        if text.says(NoticeCode.OTHER_MASTER) or text.says(NoticeCode.NO_OTHER_MASTER):
            last[str(text.value_of("bus"))] = text
    for bus in config.buses:
        if (text := last.get(bus.name, NOTHING)).says(NoticeCode.OTHER_MASTER):
            yield HealthFinding(
                text,
                "two masters on one line destroy each other's answers",
                "find the other program or controller (frames above), and let only one of them ask on this line",
            )


def _scatter(residuals_um: Sequence[float]) -> Iterator[HealthFinding]:
    """The newest cycles against the first ones."""
    if len(residuals_um) < 2 * _SCATTER_CYCLES:
        return
    first = float(np.median(residuals_um[:_SCATTER_CYCLES]))
    last = float(np.median(residuals_um[-_SCATTER_CYCLES:]))
    if last > _SCATTER_GROWN * first:
        yield HealthFinding(
            f"the residual of probing cycles, which no rigid body explains, grew from {first:.1f} to {last:.1f} µm "
            "(medians of ten)",
            "all errors are learnt from these touches",
            "clean the sphere, check its clamping and the probe's stylus and battery",
        )


def _too_equal(history: History, config: GatewayConfig) -> Iterator[HealthFinding]:
    """Inputs that were the same all day although they moved."""
    names = [channel.name for channel in config.channels]
    last_k = history.latest_k()
    if last_k is None:
        return
    a_day = steps_in(DAY_S, config.grid.step_s)
    frames = history.frames(names, last_k - a_day + 1, last_k)
    inputs = np.where(frames.valid, frames.inputs, np.nan)
    for a, b in combinations(range(len(names)), 2):
        if _same(inputs[:, a], inputs[:, b], a_day // 2):
            yield HealthFinding(
                f"{names[a]} and {names[b]} were the same all day",
                "they may be one sensor under two names, or two in one hole; then one of them adds no information",
                "warm each by hand while `talc-gateway probe --watch` runs",
            )


def _same(a: FloatArray, b: FloatArray, least: int) -> bool:
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < least:
        return False
    return bool(np.ptp(a[known]) > _MOVED_K and np.max(np.abs(a[known] - b[known])) < _SAME_K)
