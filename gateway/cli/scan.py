"""`talc-gateway scan`: its commands `ports`, `serial`, `tcp` and `can`."""

import sys
from collections.abc import Awaitable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from drivers.can.survey import Stopped
from drivers.canopen.settings import CanOpenSettings
from drivers.micro_epsilon.settings import MeRs485Settings
from drivers.modbus.settings import ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.problems import read_settings
from gateway.cli.arguments import (
    SCAN_LIMIT_S,
    FiniteNumber,
    Written,
    answer_timeout,
    field_option,
    field_type,
    gathered,
    numbers,
)
from gateway.cli.exits import EXIT_WORLD
from gateway.commissioning.scan.can import CanScan, scan_can
from gateway.commissioning.scan.found import ScanProgress, ScanReport
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
    ScanEnding,
    scan_to_file,
)
from gateway.commissioning.scan.serial import plan, scan_line, scanned_port
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts, scanned_host

timeout = partial(answer_timeout, "Seconds to wait for an answer.")


with_ending = gathered(
    "ending",
    ScanEnding,
    click.option("--limit", type=FiniteNumber(min=1), default=SCAN_LIMIT_S, show_default=True,
                 help="Stop after this many seconds."),
    click.option("--toml", type=click.Path(dir_okay=False, path_type=Path, allow_dash=True),
                 help="Write a configuration for the devices found, or, after a question, add to one. -: standard "
                 "output."),
    click.option("--yes", is_flag=True, help="Answer every question with yes."),
)  # fmt: skip


@click.command("ports")
def ports_command() -> None:
    """List this computer's serial ports and CAN interfaces. Opens none of them."""
    found = find_ports()
    for port in found:
        click.echo(f"scan {port.command} {port.name}    ({port.remark})")
    if not found:
        click.echo("no serial adapter and no CAN interface: is the adapter plugged in? dmesg shows what was connected")
    sys.exit(0 if found else EXIT_WORLD)


@click.command("serial")
@click.argument("port", type=Written("path", scanned_port))
@click.option("--baud", "bauds", type=field_type(ModbusRtuSettings, "baud"), multiple=True, default=BAUDS,
              show_default=True, help="Speed to try; may be given several times.")  # fmt: skip
@click.option("--parity", "parities", type=field_type(ModbusRtuSettings, "parity"), multiple=True,
              default=PARITIES, show_default=True)  # fmt: skip
@click.option(
    "--units", type=numbers(*ModbusRtuSettings.units), default="1-32", show_default=True, help="Modbus unit ids to ask."
)
@click.option("--me-baud", "me_bauds", type=field_type(MeRs485Settings, "baud"), multiple=True, default=ME_BAUDS,
              show_default=True, help="Speeds at which Micro-Epsilon sensors are asked, parity N and E.")  # fmt: skip
@click.option("--me-addresses", type=numbers(*MeRs485Settings.units), default="126", show_default=True)
@click.option("--protocol", type=click.Choice(["both", "modbus_rtu", "me_rs485"]), default="both", show_default=True)
@click.option("--function", type=click.Choice([3, 4]), default=3, show_default=True,
              help="Function code for reading; some simple units support only 4 and do not refuse 3.")  # fmt: skip
@timeout(SERIAL_TIMEOUT_S)
@with_ending
def serial_command(
    port: str, protocol: str, units: tuple[int, ...], me_addresses: tuple[int, ...], ending: ScanEnding, **line: Any
) -> None:
    """Find Modbus RTU units and Micro-Epsilon sensors on the serial PORT."""
    asked = units if protocol != "me_rs485" else ()
    what = plan(port, units=asked, me_addresses=me_addresses if protocol != "modbus_rtu" else (), **line)
    found = scan_to_file(
        f"{port}: {what.intro}", what.requests, what.longest_s, ending, lambda p, s, _: scan_line(what, p, s)
    )
    sys.exit(0 if found else EXIT_WORLD)


@click.command("tcp")
@click.argument("hosts", type=Written("host", scanned_host), nargs=-1, required=True)
@click.option("--units", type=numbers(*ModbusTcpSettings.units), default="1", show_default=True,
              help="Units to ask behind each host.")  # fmt: skip
@click.option("--rtu", is_flag=True,
              help="Ask with RTU frames: for a device server that passes on the bytes of its serial line.")  # fmt: skip
@timeout(TCP_TIMEOUT_S)
@with_ending
def tcp_command(
    hosts: tuple[tuple[str, int | None], ...],
    units: tuple[int, ...],
    rtu: bool,
    timeout_s: float,
    ending: ScanEnding,
) -> None:
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
    found = scan_to_file(what.intro, what.requests, what.longest_s, ending, lambda p, s, _: scan_hosts(what, p, s))
    sys.exit(0 if found else EXIT_WORLD)


@click.command("can")
@click.argument("channel")
@field_option("--interface", CanOpenSettings, "interface")
@click.option("--bitrate", "bitrates", type=field_type(CanOpenSettings, "bitrate"),
              multiple=True, help=f"Bit rates to try on slcan. Default: {', '.join(map(str, BITRATES))}.")  # fmt: skip
@click.option(
    "--nodes", type=numbers(*CanOpenSettings.units), default="1-127", show_default=True, help="CANopen nodes to ask."
)
@click.option("--listen", "listen_s", type=FiniteNumber(0, 3600), default=LISTEN_S, show_default=True,
              help="Listen this many seconds before asking.")  # fmt: skip
@timeout(CAN_TIMEOUT_S)
@field_option("--udp-port", CanOpenSettings, "port", "For udp_multicast only.")
@with_ending
def can_command(
    channel: str,
    interface: str,
    bitrates: tuple[int, ...],
    nodes: tuple[int, ...],
    listen_s: float,
    timeout_s: float,
    port: int,
    ending: ScanEnding,
) -> None:
    """Find CANopen nodes and plain CAN frames on CHANNEL: can0, or the serial port of an slcan adapter.

    \b
    The system sets the bit rate of a socketcan interface, so the scan cannot try several:
      ip link set can0 up type can bitrate 125000 restart-ms 100
    On slcan the scan first only listens at every rate (the adapter sends nothing, not even acknowledgements).
    """
    if len(bitrates) > 1 and interface != "slcan":
        raise click.UsageError(f"--bitrate: the rate of {interface} cannot be changed here; give one rate, or none")
    settings = read_settings(CanOpenSettings, {"interface": interface, "channel": channel, "port": port})
    rates = bitrates or (BITRATES if interface == "slcan" else (settings.bitrate,))
    what = CanScan(settings, rates, nodes, listen_s, timeout_s)

    def run(tell: ScanProgress, stopped: Stopped, anyway: bool) -> Awaitable[ScanReport]:
        return scan_can(replace(what, anyway=anyway), tell, stopped)

    found = scan_to_file(what.intro, 2 * len(rates), what.longest_s, ending, run)
    sys.exit(0 if found else EXIT_WORLD)
