"""`talc-gateway scan`: finds the devices on a wire, prints a table and writes a configuration."""

import asyncio
import sys
from collections.abc import Awaitable, Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from drivers.bus_settings import Parity
from drivers.can import Stopped
from drivers.canopen import CanOpenSettings
from drivers.micro_epsilon import MeRs485Settings
from drivers.modbus import ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.problems import read_settings
from drivers.recognition import describe
from drivers.section import LONGEST_ANSWER_S, host_and_port
from gateway.cli.conventions.arguments import SCAN_LIMIT_S, FiniteNumber, field_option, field_type
from gateway.cli.conventions.signals import stop_on_signals
from gateway.cli.conventions.terminal import duration_text, terminal
from gateway.commissioning.scan.can import CanScan, scan_can
from gateway.commissioning.scan.found import ScanProgress, ScanReport
from gateway.commissioning.scan.fragment import check_addable, merged
from gateway.commissioning.scan.ports import find_ports
from gateway.commissioning.scan.serial import plan, scan_line, scanned_port
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts, scanned_host
from gateway.config.problems import ConfigError, Problem
from gateway.config.reading import read_text

ScanRun = Callable[[ScanProgress, Stopped, bool], Awaitable[ScanReport]]
"""A scan; the argument says whether a report's question was answered with yes."""

BAUDS = (9600, 19200, 38400, 57600, 115200)
ME_BAUDS = (230_400, 256_000)
PARITIES: tuple[Parity, ...] = ("N",)
BITRATES = (125_000, 250_000, 500_000, 1_000_000)
SERIAL_TIMEOUT_S, TCP_TIMEOUT_S, CAN_TIMEOUT_S, LISTEN_S = 0.15, 1.0, 0.3, 3.0
_EXIT_NOTHING = 3


class Numbers(click.ParamType[tuple[int, ...]]):
    """`1-8,12`: whole numbers within bounds, each once, in order."""

    name = "numbers"

    def __init__(self, low: int, high: int) -> None:
        self._low, self._high = low, high

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        found: set[int] = set()
        for part in str(value).split(","):
            first, _, last = part.strip().partition("-")
            if not first.isdecimal() or not (last or first).isdecimal():
                self.fail(f"{value!r}: expected numbers such as 1-8,12", param, ctx)
            if int(last or first) < int(first):
                self.fail(f"{value!r}: expected the smaller number first, {last}-{first}", param, ctx)
            found |= set(range(int(first), int(last or first) + 1))
        if min(found) < self._low or max(found) > self._high:
            self.fail(f"{value!r}: expected {self._low} to {self._high}", param, ctx)
        return tuple(sorted(found))


class Host(click.ParamType[tuple[str, int | None]]):
    """`name` or `name:port`."""

    name = "host"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int | None]:
        try:
            return scanned_host(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


class SerialPath(click.ParamType[str]):
    """The path of a serial port of this computer."""

    name = "path"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return scanned_port(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


Toml = click.option(
    "--toml", type=click.Path(dir_okay=False, path_type=Path, allow_dash=True),
    help="Write a configuration for the devices found, or, after a question, add to one. -: standard output.",
)  # fmt: skip
Limit = click.option(
    "--limit", type=FiniteNumber(min=1), default=SCAN_LIMIT_S, show_default=True, help="Stop after this many seconds."
)
Yes = click.option("--yes", is_flag=True, help="Answer every question with yes.")


@click.command("ports")
def ports_command() -> None:
    """List this computer's serial ports and CAN interfaces. Opens none of them."""
    found = find_ports()
    for port in found:
        click.echo(f"scan {port.command} {port.name}    ({port.remark})")
    if not found:
        click.echo("no serial adapter and no CAN interface: is the adapter plugged in? dmesg shows what was connected")
    sys.exit(0 if found else _EXIT_NOTHING)


@click.command("serial")
@click.argument("port", type=SerialPath())
@click.option("--baud", "bauds", type=field_type(ModbusRtuSettings, "baud"), multiple=True, default=BAUDS,
              show_default=True, help="Speed to try; may be given several times.")  # fmt: skip
@click.option(
    "--parity",
    "parities",
    type=field_type(ModbusRtuSettings, "parity"),
    multiple=True,
    default=PARITIES,
    show_default=True,
)
@click.option(
    "--units", type=Numbers(*ModbusRtuSettings.units), default="1-32", show_default=True, help="Modbus unit ids to ask."
)
@click.option("--me-baud", "me_bauds", type=field_type(MeRs485Settings, "baud"), multiple=True, default=ME_BAUDS,
              show_default=True, help="Speeds at which Micro-Epsilon sensors are asked, parity N and E.")  # fmt: skip
@click.option("--me-addresses", type=Numbers(*MeRs485Settings.units), default="126", show_default=True)
@click.option("--protocol", type=click.Choice(["both", "modbus_rtu", "me_rs485"]), default="both", show_default=True)
@click.option("--function", type=click.Choice([3, 4]), default=3, show_default=True,
              help="Function code for reading; some simple units support only 4 and do not refuse 3.")  # fmt: skip
@click.option("--timeout", "timeout_s", type=FiniteNumber(0.01, LONGEST_ANSWER_S), default=SERIAL_TIMEOUT_S,
              show_default=True, help="Seconds that a unit may take to answer.")  # fmt: skip
@Limit
@Toml
@Yes
def serial_command(
    port: str, bauds: tuple[int, ...], parities: tuple[Parity, ...], units: tuple[int, ...], me_bauds: tuple[int, ...],
    me_addresses: tuple[int, ...], protocol: str, function: int, timeout_s: float, limit: float, toml: Path | None,
    yes: bool,
) -> None:  # fmt: skip
    """Find Modbus RTU units and Micro-Epsilon sensors on the serial PORT."""
    what = plan(
        port, bauds=bauds, parities=parities, units=units if protocol != "me_rs485" else (), me_bauds=me_bauds,
        me_addresses=me_addresses if protocol != "modbus_rtu" else (), timeout_s=timeout_s, function=function,
    )  # fmt: skip
    framings: dict[str, list[str]] = {}
    for attempt in what.tries:
        framings.setdefault(attempt.protocol, []).append(attempt.framing)
    listed = "; ".join(f"{protocol} at {', '.join(at)}" for protocol, at in framings.items())
    intro = f"{port}: {what.requests} requests ({listed})"
    _scan(intro, what.requests, what.longest_s, limit, toml, yes, lambda p, s, _: scan_line(what, p, s))


@click.command("tcp")
@click.argument("hosts", type=Host(), nargs=-1, required=True)
@click.option(
    "--units",
    type=Numbers(*ModbusTcpSettings.units),
    default="1",
    show_default=True,
    help="Units to ask behind each host.",
)
@click.option("--rtu", is_flag=True,
              help="Ask with RTU frames: for a device server that passes on the bytes of its serial line.")  # fmt: skip
@click.option(
    "--timeout",
    "timeout_s",
    type=FiniteNumber(0.01, LONGEST_ANSWER_S),
    default=TCP_TIMEOUT_S,
    show_default=True,
    help="Seconds to wait for an answer.",
)
@Limit
@Toml
@Yes
def tcp_command(
    hosts: tuple[tuple[str, int | None], ...], units: tuple[int, ...], rtu: bool, timeout_s: float,
    limit: float, toml: Path | None, yes: bool,
) -> None:  # fmt: skip
    """Find Modbus TCP units behind HOSTS (host or host:port), and Micro-Epsilon controllers. Asks only these hosts.

    Without a port, 502 (Modbus) and 10001 (a controller's data) are tried. Behind a gateway to a serial line each
    device has its own unit id: --units 1-16. A device server's port must be given: --rtu HOST:4001.
    """
    if rtu and (portless := [host for host, port in hosts if port is None]):
        raise click.UsageError(f"--rtu: {portless[0]}: give the device server's port, such as {portless[0]}:4001")
    lowest, highest = ModbusRtuTcpSettings.units
    if rtu and not lowest <= min(units) <= max(units) <= highest:
        raise click.UsageError(f"--units: expected {lowest} to {highest} with --rtu")
    what = TcpScan(hosts, units, timeout_s, rtu)
    listed = ", ".join(host if port is None else host_and_port(host, port) for host, port in hosts)
    intro = f"{listed}: {what.requests} requests"
    _scan(intro, what.requests, what.longest_s, limit, toml, yes, lambda p, s, _: scan_hosts(what, p, s))


@click.command("can")
@click.argument("channel")
@field_option("--interface", CanOpenSettings, "interface")
@click.option("--bitrate", "bitrates", type=field_type(CanOpenSettings, "bitrate"),
              multiple=True, help=f"Bit rates to try on slcan. Default: {', '.join(map(str, BITRATES))}.")  # fmt: skip
@click.option(
    "--nodes", type=Numbers(*CanOpenSettings.units), default="1-127", show_default=True, help="CANopen nodes to ask."
)
@click.option("--listen", "listen_s", type=FiniteNumber(0, 3600), default=LISTEN_S, show_default=True,
              help="Listen this many seconds before asking.")  # fmt: skip
@click.option(
    "--timeout",
    "timeout_s",
    type=FiniteNumber(0.01, LONGEST_ANSWER_S),
    default=CAN_TIMEOUT_S,
    show_default=True,
    help="Seconds to wait for an answer.",
)
@field_option("--udp-port", CanOpenSettings, "port", "For udp_multicast only.")
@Limit
@Toml
@Yes
def can_command(
    channel: str, interface: str, bitrates: tuple[int, ...], nodes: tuple[int, ...], listen_s: float, timeout_s: float,
    udp_port: int, limit: float, toml: Path | None, yes: bool,
) -> None:  # fmt: skip
    """Find CANopen nodes and plain CAN frames on CHANNEL: can0, or the serial port of an slcan adapter.

    \b
    The system sets the bit rate of a socketcan interface, so the scan cannot try several:
      ip link set can0 up type can bitrate 125000 restart-ms 100
    On slcan the scan first only listens at every rate (the adapter sends nothing, not even acknowledgements).
    """
    if len(bitrates) > 1 and interface != "slcan":
        raise click.UsageError(f"--bitrate: the rate of {interface} cannot be changed here; give one rate, or none")
    settings = read_settings(CanOpenSettings, {"interface": interface, "channel": channel, "port": udp_port})
    rates = bitrates or (BITRATES if interface == "slcan" else (settings.bitrate,))
    what = CanScan(settings, rates, nodes, listen_s, timeout_s)
    rate = "bit rate set by the system" if interface == "socketcan" else f"bit rates {', '.join(map(str, rates))}"
    intro = f"{interface} {channel}: listening, then asking {len(nodes)} nodes ({rate})"

    def run(tell: ScanProgress, stopped: Stopped, anyway: bool) -> Awaitable[ScanReport]:
        return scan_can(replace(what, anyway=anyway), tell, stopped)

    _scan(intro, 2 * len(rates), what.longest_s, limit, toml, yes, run)


def _scan(intro: str, total: int, longest_s: float, limit_s: float, toml: Path | None, yes: bool, run: ScanRun) -> None:
    """Check the file, print the longest duration, scan with a progress bar, print the table, write the file."""
    _existing(toml)
    said = terminal(stderr=True)
    said.print(
        f"{intro}; at most {duration_text(max(1.0, longest_s))} if nothing answers", soft_wrap=True, highlight=False
    )
    if longest_s > limit_s:
        said.print(
            f"it will be stopped after {duration_text(max(1.0, limit_s))}; name fewer speeds or units, or raise --limit"
        )
    report, ended = find(said, total, limit_s, run, yes)
    console = terminal(stderr=str(toml) == "-")  # only the configuration goes to a pipe
    print_report(console, report, ended)
    if toml is not None:
        if any(device.what.profile for device in report.found):
            _write(toml, report, yes)
        else:
            click.echo(f"nothing was recognised; {toml} was not written", err=True)
    sys.exit(0 if report.found else _EXIT_NOTHING)


def find(said: Console, total: int, limit_s: float, run: ScanRun, yes: bool) -> tuple[ScanReport, str]:
    """The report of a scan, after its question if it has one; and the reason if it ended early."""
    report, ended = asyncio.run(_run(said, total, limit_s, lambda p, s: run(p, s, yes)))
    if report.question and _agreed(report.question):
        report, ended = asyncio.run(_run(said, total, limit_s, lambda p, s: run(p, s, True)))
    return report, ended


def _existing(toml: Path | None) -> None:
    """Check before a long scan that its result can be added to the file. Raises ConfigError."""
    if toml is None or str(toml) == "-" or not toml.exists():
        return
    try:
        check_addable(read_text(toml), toml)
    except ConfigError as error:
        advice = Problem("", "nothing was scanned: correct this file, or give another one with --toml")
        raise ConfigError(toml, [*error.problems, advice]) from None


async def _run(
    said: Console, total: int, limit_s: float, run: Callable[[ScanProgress, Stopped], Awaitable[ScanReport]]
) -> tuple[ScanReport, str]:
    """The report, and the reason if the scan ended early."""
    stop = asyncio.Event()
    stop_on_signals(stop)
    loop = asyncio.get_running_loop()
    deadline = loop.time() + limit_s
    columns = (
        BarColumn(20),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=said, transient=True) if said.is_terminal else nullcontext() as bar:
        task = None if bar is None else bar.add_task("", total=total)

        def tell(done: int, text: str) -> None:
            if bar is not None and task is not None:
                bar.update(task, completed=done, description=text)

        report = await run(tell, lambda: stop.is_set() or loop.time() > deadline)
    if stop.is_set():
        return report, "interrupted"
    return report, f"stopped after {duration_text(max(1.0, limit_s))}" if loop.time() > deadline else ""


def print_report(console: Console, report: ScanReport, ended: str) -> None:
    """A table of each place, remarks, and the counts."""
    for place in report.places:
        table = Table(
            "unit", "profile", "inputs", "evidence, and what they read", title=place.title, title_justify="left"
        )
        for device in place.devices:
            what = device.what
            text = "\n".join(
                [what.evidence, *([device.reads] if device.reads else []), *(f"check {d}" for d in what.doubts)]
            )
            table.add_row(str(device.unit), what.profile or "unknown", describe(what.inputs), text)
        console.print(table)
    for remark in report.remarks:
        console.print(f"- {remark}", highlight=False, soft_wrap=True)
    known = sum(bool(device.what.profile) for device in report.found)
    console.print(f"{len(report.found)} answered, {known} recognised")
    if ended:
        console.print(f"{ended}: {report.asked} of {report.total} asked", style="yellow")


def _write(path: Path, report: ScanReport, yes: bool) -> None:
    if str(path) == "-":
        click.echo(merged("", report.places, Path("found.toml")), nl=False)
        return
    existing = read_text(path) if path.exists() else ""
    text = merged(existing, report.places, path)
    if text == existing:
        click.echo(f"{path} already contains everything", err=True)
        return
    if existing and not yes and not _agreed(f"{path} exists. Add what is missing?"):
        click.echo(f"{path} stays as it is. A configuration of what was found:\n", err=True)
        click.echo(merged("", report.places, Path("found.toml")), nl=False)
        return
    path.write_text(text, encoding="utf-8")
    click.echo(
        f"{path} {'extended' if existing else 'written'}: name the channels, then talc-gateway probe {path}", err=True
    )


def _agreed(question: str) -> bool:
    """Whether the answer is yes. Ctrl-C, and an input that has ended, are no: what was found must not be lost."""
    try:
        return click.confirm(question, err=True)
    except click.Abort:
        click.echo(err=True)
        return False
