"""The first configuration of a machine: asks what no scan can find out, scans, and writes it."""

import asyncio
import os
import re
import socket
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import click

from drivers.base import DriverError, SetupError
from drivers.can.survey import Stopped
from drivers.canopen.settings import CanOpenSettings
from drivers.mtconnect.make import suggest_mtconnect
from drivers.mtconnect.suggest import SuggestedItems
from drivers.problems import read_settings
from gateway.commissioning.scan.can import CanScan, scan_can
from gateway.commissioning.scan.first import (
    Answers,
    ControlAnswers,
    LinuxCncAnswers,
    MtConnectAnswers,
    SinumerikAnswers,
    first_configuration,
    read_answers,
    to_confirm,
)
from gateway.commissioning.scan.found import Place, ScanProgress, ScanReport
from gateway.commissioning.scan.ports import ScanPort, find_ports
from gateway.commissioning.scan.run import (
    BAUDS,
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
from gateway.runtime.terminal import terminal

_CONTROLS: Final[Mapping[str, tuple[type[ControlAnswers], Mapping[str, str]]]] = {
    "sinumerik": (
        SinumerikAnswers,
        {
            "url": "Address of its OPC UA server",
            "user": "OPC UA user",
            "folder": "Folder of password, certificates and key",
        },
    ),
    "linuxcnc": (LinuxCncAnswers, {"host": "Host of its agent", "key_file": "Copy of the agent's key"}),
    "agent": (LinuxCncAnswers, {"host": "Host of the agent", "key_file": "Copy of the agent's key"}),
    "mtconnect": (
        MtConnectAnswers,
        {"url": "Address of its MTConnect agent", "machine": "Its machine's name, if the agent has several"},
    ),
}
"""Kind of control to its answers, and the question for each of them."""
_AGENT_TIMEOUT_S = 5.0
_UNITS = tuple(range(1, 33))
_ME_ADDRESSES = (126,)
_NODES = tuple(range(CanOpenSettings.units[0], CanOpenSettings.units[1] + 1))


@dataclass(frozen=True, slots=True)
class _Wire:
    """One scan to be made."""

    name: str
    total: int
    run: ScanRun


def init(path: Path, answers_file: Path | None, limit_s: float) -> bool:
    """Write `path`; False if no device was recognised, and nothing was written.

    Raises ConfigError for an invalid answer.

    An existing file is replaced only if it is the Debian package's example, which nobody has changed.
    """
    if not os.access(path.resolve().parent, os.W_OK):
        raise click.UsageError(
            f"the folder {path.resolve().parent} cannot be written: does it exist, and may you write there?"
        )
    if path.exists() and not _is_example(path):
        raise click.UsageError(f"{path} exists; `talc-gateway scan … --toml {path}` adds devices to it")
    given = _asked(find_ports()) if answers_file is None else read_answers(answers_file)
    places = _found(given, limit_s)
    if not any(device.what.profile for place in places for device in place.devices):
        click.echo(
            f"no device was recognised, so {path} was not written: without one there is nothing to learn from. "
            "`talc-gateway scan` has more speeds, units and nodes; docs/own-profile.md shows a profile of your own",
            err=True,
        )
        return False
    items = _described(given.control) if isinstance(given.control, MtConnectAnswers) else None
    text = first_configuration(given, places, path, items)
    path.write_text(text, encoding="utf-8")
    guesses = to_confirm(text)
    click.echo(f"{path} written; {len(guesses)} line{'' if len(guesses) == 1 else 's'} to confirm:")
    for number, what in guesses:
        click.echo(f"  line {number}: {what}")
    click.echo(f"next: talc-gateway check {path}; talc-gateway probe {path}; docs/arming.md leads from there")
    return True


def _is_example(path: Path) -> bool:
    """Whether the file is what the Debian package's postinst has copied from the program's folder."""
    try:
        return path.read_bytes() == Path(sys.prefix, "share", "gateway.toml").read_bytes()
    except OSError:
        return False


def _asked(ports: list[ScanPort]) -> Answers:
    """The integrator's answers. Ctrl-C, and an input that has ended, end the command."""
    host = re.sub(r"\W", "_", socket.gethostname().split(".")[0], flags=re.ASCII)
    machine = click.prompt("Name of the machine", default=host, value_proc=_name)
    wanted: dict[str, list[str]] = {"serial": [], "can": []}
    for port in ports:
        if click.confirm(f"Look for devices on {port.name} ({port.remark})?", default=True):
            wanted[port.command].append(port.name)
    hosts = click.prompt(
        "Modbus TCP devices and Micro-Epsilon controllers, host or host:port, with blanks between", default=""
    )
    kind = click.prompt("Control", type=click.Choice(["none", *_CONTROLS]), default="none")
    data: dict[str, object] = {"machine": machine, **wanted, "hosts": hosts.split()}
    if kind in _CONTROLS:
        fields, questions = _CONTROLS[kind]
        data["control"] = {"kind": kind} | {
            name: click.prompt(question, default=fields.model_fields[name].default)
            for name, question in questions.items()
        }
    return read_settings(Answers, data)


def _name(text: str) -> str:
    """A machine's name; click asks again for another one."""
    try:
        return read_settings(Answers, {"machine": text}).machine
    except SetupError as error:
        raise click.UsageError(str(error)) from None


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
    for port in dict.fromkeys(answers.serial):
        line = plan(
            port, bauds=answers.bauds or BAUDS, parities=PARITIES, units=_UNITS, me_bauds=ME_BAUDS,
            me_addresses=_ME_ADDRESSES, timeout_s=SERIAL_TIMEOUT_S,
        )  # fmt: skip
        yield _Wire(port, line.requests, _by(partial(scan_line, line)))
    for channel in dict.fromkeys(answers.can):
        place = read_settings(CanOpenSettings, {"interface": "socketcan", "channel": channel})
        bus = CanScan(place, (place.bitrate,), _NODES, LISTEN_S, CAN_TIMEOUT_S)
        yield _Wire(channel, len(_NODES), _by(partial(scan_can, bus)))
    if answers.hosts:
        hosts = TcpScan(tuple(scanned_host(host) for host in dict.fromkeys(answers.hosts)), (1,), TCP_TIMEOUT_S)
        yield _Wire(", ".join(answers.hosts), hosts.requests, _by(partial(scan_hosts, hosts)))


def _by(scan: Callable[[ScanProgress, Stopped], Awaitable[ScanReport]]) -> ScanRun:
    """A scan that has no question."""
    return lambda progress, stopped, _: scan(progress, stopped)
