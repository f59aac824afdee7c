"""`talc-gateway doctor`: what is wrong around the gateway on this computer, why it matters, and what to do."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.can.settings import CanInterfaceSettings
from gateway.commissioning.doctor.credential_files import spoilt_file, unread_files
from gateway.commissioning.doctor.kernel_files import kernel_text
from gateway.commissioning.doctor.power import power
from gateway.commissioning.scan.ports import has_own_name, sockets_of, usb_adapter
from gateway.config.model import GatewayConfig
from gateway.config.rules import cautions
from gateway.config.telemetry_rules import credential_problems
from gateway.control.restart.proven import dry_run_wanted
from gateway.model.codes import NoticeCode
from gateway.model.text import NOTHING, Language, Text, plain
from gateway.runtime.terminal import terminal
from gateway.runtime.time_service import clock_synchronised
from gateway.storage.answers import answered
from gateway.storage.history import History
from talc.frame import EventKind, FloatArray
from talc.steps import DAY_S, steps_in

_SCATTER_CYCLES = 10
_SCATTER_GROWN = 2.0
_MASTER = "/dev/ptmx"
"""The other end of a pseudo-terminal."""
_AT_ROUTER = (NoticeCode.TELEMETRY_UNCONFIRMED, NoticeCode.TWO_OF_ONE_NAME)
_SAME_K = 0.02
_MOVED_K = 0.5


class HealthFinding(NamedTuple):
    """One thing that is wrong, in the language of who reads it."""

    what: str
    why: str
    remedy: str


def show(config: GatewayConfig, root: Path = Path("/"), *, sees_all: bool | None = None, language: str = "en") -> bool:
    """Print every finding, and what this user cannot see; True if there is no finding.

    root: where /sys, /proc and /run are
    sees_all: whether this user sees the open files of all users' processes; None: root does
    """
    console, said = terminal(), Language(language)
    if sees_all is None:
        sees_all = os.geteuid() == 0
    found = list(health_findings(config, root, synchronised=clock_synchronised() is True, language=language))
    lines = [said("doctor.finding", **finding._asdict()) for finding in found] or [said("doctor.nothing")]
    if not sees_all and any(bus.serial_path for bus in config.buses):
        lines.append(said("doctor.unseen"))
    for line in lines:
        console.print(line, soft_wrap=True)
    return not found


def health_findings(
    config: GatewayConfig, root: Path, *, synchronised: bool, language: str = "en"
) -> Iterator[HealthFinding]:
    """Everything that is wrong, the computer first.

    synchronised: whether a time service has set this computer's clock
    """
    for text in _found(config, root, synchronised=synchronised):
        said = (text.about(group, language) for group in ("text", "matters", "remedy"))
        yield HealthFinding(*said)


def _found(config: GatewayConfig, root: Path, *, synchronised: bool) -> Iterator[Text]:
    if not synchronised:
        yield Text(NoticeCode.CLOCK_NOT_SET)
    yield from _disk(config)
    yield from power(root)
    yield from _can(config, root)
    yield from _other_programs(config, root)
    yield from _shared_names(config, root)
    unread = unread_files(config)
    yield from unread.values()
    for caution in cautions(config):
        if caution.where not in unread:
            yield Text(NoticeCode.CONFIG_CAUTION, caution=str(caution))
    spoilt = [one for one in credential_problems(config.telemetry, datetime.now(UTC)) if one.where not in unread]
    yield from (spoilt_file(config, problem) for problem in spoilt)
    if not (unread or spoilt):
        yield from _unreached(config)
    if why := dry_run_wanted(config):
        yield why
    if answered(config.storage.path, config.storage.path.is_file):
        with History(config.storage.path) as history:
            yield from _of_telemetry(history)
            yield from _other_masters(history, config)
            yield from _scatter(history.residuals_um())
            yield from _too_equal(history, config)


def _unreached(config: GatewayConfig) -> Iterator[Text]:
    """The places that this computer cannot connect to as the gateway would."""
    telemetry = config.telemetry
    if not (telemetry.enabled and telemetry.connecting):
        return
    from gateway.telemetry.reaching import cause  # only here: it loads Zenoh
    from gateway.telemetry.session import own_access

    for place in telemetry.connecting:
        if (why := cause(place, own_access(telemetry))) is not None:
            yield Text(NoticeCode.TELEMETRY_AWAY, places=place.text, why=why)


def _disk(config: GatewayConfig) -> Iterator[Text]:
    folder, limit_mb = config.storage.path.parent, config.storage.warn_free_mb
    if not folder.is_dir():
        yield Text(NoticeCode.FOLDER_ABSENT, folder=str(folder))
        return
    free = os.statvfs(folder)
    free_mb = free.f_bavail * free.f_frsize / 1e6
    if free_mb < limit_mb:
        yield Text(NoticeCode.DISK_NEARLY_FULL, free_mb=free_mb, folder=str(folder), limit_mb=limit_mb)


def _can(config: GatewayConfig, root: Path) -> Iterator[Text]:
    for bus in config.buses:
        settings: object = bus  # of any family
        if not isinstance(settings, CanInterfaceSettings) or settings.interface != "socketcan":
            continue
        channel = settings.channel
        state = kernel_text(root / "sys/class/net" / channel / "operstate")
        if not state:
            yield Text(NoticeCode.CAN_ABSENT, channel=channel, bus=bus.name)
        elif state == "down" and _is_up(root, channel):
            yield Text(NoticeCode.CAN_LEFT_BUS, channel=channel, bus=bus.name)
        elif state == "down":
            yield Text(NoticeCode.CAN_DOWN, channel=channel, bus=bus.name, bitrate=str(settings.bitrate))


def _is_up(root: Path, interface: str) -> bool:
    """Whether somebody has switched it on (IFF_UP)."""
    flags = kernel_text(root / "sys/class/net" / interface / "flags")
    return flags.startswith("0x") and bool(int(flags, 16) & 1)


def _other_programs(config: GatewayConfig, root: Path) -> Iterator[Text]:
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
            named = _named(root, processes)
            yield Text(NoticeCode.LINE_SHARED, bus=ports[port], port=port, n=len(processes), processes=named)


def _shared_names(config: GatewayConfig, root: Path) -> Iterator[Text]:
    """Serial ports whose by-id name several adapters that are plugged in have."""
    sockets = sockets_of(root / "dev")
    usb = {device: folder for device in sockets if (folder := usb_adapter(device, root / "sys")) is not None}
    kinds = Counter(_kind(folder) for folder in set(usb.values()))
    for bus in config.buses:
        line = bus.serial_path
        if line is None or "/serial/by-id/" not in line[1]:
            continue
        device = (root / line[1].removeprefix("/")).resolve()
        if device in usb and not has_own_name(device, root / "sys") and kinds[_kind(usb[device])] > 1:
            yield Text(NoticeCode.NAME_SHARED, bus=bus.name, port=line[1], socket=str(sockets[device]))


def _kind(usb: Path) -> tuple[str, str]:
    return kernel_text(usb / "idVendor"), kernel_text(usb / "idProduct")


def _named(root: Path, processes: Iterable[str]) -> str:
    found = ((number, kernel_text(root / "proc" / number / "comm")) for number in sorted(processes, key=int))
    return ", ".join(f"{number} ({name})" if name else number for number, name in found)


def _open_files(process: Path) -> Iterator[str]:
    """What a process has open; it may end while it is listed, or belong to another user."""
    with suppress(OSError):
        for link in (process / "fd").iterdir():
            with suppress(OSError):
                yield str(link.readlink())


def _of_telemetry(history: History) -> Iterator[Text]:
    """What the running gateway has found at its router, and not seen end."""
    last: dict[object, tuple[EventKind, Text]] = {}
    for _, event in history.troubles():
        last[event.values.get("subject")] = event.kind, plain(event.text)
    for kind, text in last.values():
        if kind is EventKind.PROBLEM and any(map(text.says, _AT_ROUTER)):
            yield text


def _other_masters(history: History, config: GatewayConfig) -> Iterator[Text]:
    """Buses on which the gateway hears another master, by the last event of each."""
    last: dict[str, Text] = {}
    for _, _, event in history.events():
        text = plain(event.text)
        if text.says(NoticeCode.OTHER_MASTER) or text.says(NoticeCode.NO_OTHER_MASTER):
            last[str(text.value_of("bus"))] = text
    for bus in config.buses:
        if (text := last.get(bus.name, NOTHING)).says(NoticeCode.OTHER_MASTER):
            yield text


def _scatter(residuals_um: Sequence[float]) -> Iterator[Text]:
    """The newest cycles against the first ones."""
    if len(residuals_um) < 2 * _SCATTER_CYCLES:
        return
    first = float(np.median(residuals_um[:_SCATTER_CYCLES]))
    last = float(np.median(residuals_um[-_SCATTER_CYCLES:]))
    if last > _SCATTER_GROWN * first:
        yield Text(NoticeCode.TOUCHES_SCATTER, first_um=first, last_um=last)


def _too_equal(history: History, config: GatewayConfig) -> Iterator[Text]:
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
            yield Text(NoticeCode.SAME_ALL_DAY, one=names[a], other=names[b])


def _same(a: FloatArray, b: FloatArray, least: int) -> bool:
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < least:
        return False
    return bool(np.ptp(a[known]) > _MOVED_K and np.max(np.abs(a[known] - b[known])) < _SAME_K)
