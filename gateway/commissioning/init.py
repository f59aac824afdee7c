"""The first configuration of a machine: asks what no scan can find out, scans, and writes it."""

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click

from drivers.base import DriverError
from drivers.bounded_file import bytes_of
from drivers.can.survey import Stopped
from drivers.canopen.settings import CanOpenSettings
from drivers.modbus.settings import ModbusRtuSettings, ModbusTcpSettings
from drivers.mtconnect.make import suggest_mtconnect
from drivers.mtconnect.suggest import SuggestedItems
from drivers.problems import read_settings
from gateway.commissioning.questions import asked, keep, with_own_profiles
from gateway.commissioning.scan.can import CanScan, scan_can
from gateway.commissioning.scan.first import (
    Answers,
    MtConnectAnswers,
    first_configuration,
    read_answers,
    to_confirm,
)
from gateway.commissioning.scan.found import Place, ScanProgress, ScanReport
from gateway.commissioning.scan.fragment import check_addable, unknown_devices
from gateway.commissioning.scan.ports import find_ports
from gateway.commissioning.scan.run import (
    BAUDS,
    BITRATES,
    CAN_TIMEOUT_S,
    LISTEN_S,
    ME_BAUDS,
    PARITIES,
    SERIAL_TIMEOUT_S,
    TCP_TIMEOUT_S,
    ScanRun,
    find,
    print_report,
)
from gateway.commissioning.scan.serial import plan, scan_line
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts, scanned_host
from gateway.commissioning.scan.unknown import next_command, with_profiles
from gateway.config.file import draft
from gateway.config.reading import read_text
from gateway.runtime.terminal import terminal
from gateway.runtime.whole_file import write_whole
from gateway.runtime.written import whole_numbers

_AGENT_TIMEOUT_S = 5.0
_UNITS = tuple(range(1, 33))
_HOST_UNITS = (1, 255)
"""Most devices on a network take every unit id; the others have one of these by default."""
_ME_ADDRESSES = (126,)
_NODES = tuple(range(CanOpenSettings.units[0], CanOpenSettings.units[1] + 1))


@dataclass(frozen=True, slots=True)
class _Wire:
    """One scan to be made."""

    name: str
    total: int
    run: ScanRun


def init(path: Path, answers_file: Path | None, limit_s: float) -> bool:
    """Write `path` with everything that was found, or add that to a file that `init` wrote; False: no device is known.

    The answers are kept beside it, before anything is scanned. Raises ConfigError for an invalid answer.

    An existing file that is not from `init` is replaced only if it is the Debian package's example, which nobody has
    changed.
    """
    if not os.access(path.resolve().parent, os.W_OK):
        raise click.UsageError(
            f"the folder {path.resolve().parent} cannot be written: does it exist, and may you write there?"
        )
    kept = path.with_suffix(".answers.toml")
    again = path.exists() and not _is_example(path)
    if again and not kept.exists():
        raise click.UsageError(f"{path} exists; `talc-gateway scan … --toml {path}` adds devices to it")
    existing = read_text(path) if again else ""
    if again:
        check_addable(existing, path)
    earlier = read_answers(kept) if kept.exists() else None
    given = asked(find_ports(), earlier, kept) if answers_file is None else read_answers(answers_file)
    keep(kept, given)
    places = _found(given, limit_s)
    if answers_file is None:
        given = with_own_profiles(given, unknown_devices(existing, places, path))
    given = given.model_copy(
        update={"profiles": {key: _beside(path, Path(name)) for key, name in given.profiles.items()}}
    )
    keep(kept, given)
    places = with_profiles(places, given.profiles)
    items = _described(given.control) if isinstance(given.control, MtConnectAnswers) else None
    text = first_configuration(given, places, path, items, existing)
    write_whole(path, text)
    return _told(path, text, places)


def _beside(path: Path, profile: Path) -> str:
    """The profile in the configuration's folder, copied there if it is elsewhere: the service cannot read /home or
    /root. Raises UsageError if another file of its name is there."""
    source, target = profile.absolute(), path.absolute().parent / profile.name
    if source.parent.resolve() != target.parent.resolve() and source.exists():
        content = source.read_bytes()
        if target.exists() and target.read_bytes() != content:
            raise click.UsageError(f"{target} is another profile than {source}: rename one of them")
        write_whole(target, content)
        click.echo(f"{target} written, a copy of {source}")
    return str(target)


def _told(path: Path, text: str, places: Sequence[Place]) -> bool:
    """Say what was written and what comes next; whether the file has a device."""
    known = bool(draft(text, path).devices)
    guesses = to_confirm(text)
    click.echo(f"{path} written; {len(guesses)} line{'' if len(guesses) == 1 else 's'} to confirm:")
    for number, what in guesses:
        click.echo(f"  line {number}: {what}")
    unknown = unknown_devices(text, places, path)
    for place, device in unknown:
        command = next_command(place, device) or "docs/own-profile.md shows a profile of your own"
        click.echo(f"unknown, unit {device.unit} at {place.title}; next: {command}")
    if unknown:
        click.echo(f"then talc-gateway init {path} again, which asks for the profile")
    if known:
        click.echo(f"next: talc-gateway check {path}; talc-gateway probe {path}; docs/arming.md leads from there")
        return True
    click.echo(
        f"no device was recognised: {path} has your other answers and becomes valid with its first device. "
        "`talc-gateway scan` has more speeds, units and nodes",
        err=True,
    )
    return False


def _is_example(path: Path) -> bool:
    """Whether the file is what the Debian package's postinst has copied from the program's folder."""
    try:
        return bytes_of(path) == Path(sys.prefix, "share", "gateway.toml").read_bytes()
    except OSError:
        return False


def _found(answers: Answers, limit_s: float) -> list[Place]:
    """Scan wire after wire. A wire that cannot be opened is reported, and the others are still scanned."""
    said, places = terminal(stderr=True), []
    for wire in _wires(answers):
        said.print(f"{wire.name}: at most {wire.total} requests", highlight=False)
        try:
            report, ended = find(said, wire.total, limit_s, wire.run, yes=False)
        except DriverError as error:
            said.print(f"{wire.name}: {error}", highlight=False, soft_wrap=True)
            continue
        print_report(terminal(), report, ended)
        places += report.places
    return places


def _described(control: MtConnectAnswers) -> SuggestedItems | None:
    """The data items that the agent seems to have for the gateway; None: it could not be read, which is reported."""
    said = terminal(stderr=True)
    said.print(f"{control.url}: one request", highlight=False)
    try:
        items = asyncio.run(suggest_mtconnect(control.url, control.machine, _AGENT_TIMEOUT_S))
    except DriverError as error:
        said.print(f"{error}; so its data items are placeholders", highlight=False, soft_wrap=True)
        return None
    found = {**items.positions, **items.states, **items.named}
    what = ", ".join(found) or "nothing that the gateway uses"
    terminal().print(f"{control.url} describes {what}", highlight=False, soft_wrap=True)
    return items


def _wires(answers: Answers) -> Iterator[_Wire]:
    units = None if answers.units is None else whole_numbers(*ModbusTcpSettings.units, answers.units)
    lowest, highest = ModbusRtuSettings.units
    on_lines = _UNITS if units is None else tuple(unit for unit in units if lowest <= unit <= highest)
    for port in dict.fromkeys(answers.serial):
        line = plan(
            port, bauds=answers.bauds or BAUDS, parities=PARITIES, units=on_lines, me_bauds=ME_BAUDS,
            me_addresses=_ME_ADDRESSES, timeout_s=SERIAL_TIMEOUT_S,
        )  # fmt: skip
        yield _Wire(port, line.requests, _by(partial(scan_line, line)))
    for channel in dict.fromkeys(answers.can):
        place = read_settings(CanOpenSettings, {"interface": "socketcan", "channel": channel})
        bus = CanScan(place, (place.bitrate,), _NODES, LISTEN_S, CAN_TIMEOUT_S)
        yield _Wire(channel, len(_NODES), partial(_scan_can, bus))
    for port in dict.fromkeys(answers.slcan):
        place = read_settings(CanOpenSettings, {"interface": "slcan", "channel": port})
        bus = CanScan(place, BITRATES, _NODES, LISTEN_S, CAN_TIMEOUT_S)
        yield _Wire(port, len(BITRATES) * len(_NODES), partial(_scan_can, bus))
    if answers.hosts:
        hosts = TcpScan(
            tuple(scanned_host(host) for host in dict.fromkeys(answers.hosts)), units or _HOST_UNITS, TCP_TIMEOUT_S
        )
        yield _Wire(", ".join(answers.hosts), hosts.requests, _by(partial(scan_hosts, hosts)))


async def _scan_can(scan: CanScan, progress: ScanProgress, stopped: Stopped, anyway: bool) -> ScanReport:
    return await scan_can(replace(scan, anyway=anyway), progress, stopped)


def _by(scan: Callable[[ScanProgress, Stopped], Awaitable[ScanReport]]) -> ScanRun:
    """A scan that has no question."""
    return lambda progress, stopped, _: scan(progress, stopped)
