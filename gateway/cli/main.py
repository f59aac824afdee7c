"""The commands of `talc-gateway`."""

import logging
import os
import sys
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.arguments import (
    SCAN_LIMIT_S,
    AnyFile,
    ConfigPath,
    FiniteNumber,
    KeyPrefixText,
    LanguageOption,
    OldFile,
    parsed,
    read_config,
    serving_options,
    with_access,
)
from gateway.cli.exits import EXIT_WORLD, Commands
from gateway.config.fields import DEFAULT_PREFIX, LOOPBACK
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, language_wanted
from gateway.runtime.extras import need_extra
from gateway.runtime.log import log_to_stderr

if TYPE_CHECKING:
    from gateway.telemetry.session import Access

_ELSEWHERE = {
    "agent-test": "gateway.cli.agent_test",
    "collect": "gateway.cli.collect",
    "command": "gateway.cli.command",
    "db": "gateway.cli.db",
    "doctor": "gateway.cli.condition",
    "inspect": "gateway.cli.groups",
    "name": "gateway.cli.name",
    "nc": "gateway.cli.nc",
    "prior": "gateway.cli.recorded",
    "publish": "gateway.cli.publish",
    "replay": "gateway.cli.recorded",
    "report": "gateway.cli.recorded",
    "scan": "gateway.cli.groups",
    "status": "gateway.cli.condition",
}
"""Commands that are not defined here."""


def _say_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from gateway.runtime.versions import program_version

        click.echo(f"talc-gateway, version {program_version()}")
        context.exit()


@click.group(
    cls=Commands,
    elsewhere=_ELSEWHERE,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_say_version,
              help="Show the version and exit.")  # fmt: skip
@click.option("-v", "--verbose", count=True, help="Log more; twice: everything.")
def main(verbose: int) -> None:
    """Keeps a five-axis machine tool accurate while its temperature changes.

    \b
    Exit codes: 0 success; 1 a check failed, or a fault of the program; 2 the configuration or the command line is
    invalid; 3 a fault outside the program (port in use, device absent, NC refuses).
    \b
    Messages name pages such as docs/wiring.md: the Debian package has them in /usr/share/doc/talc-gateway.
    """
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    log_to_stderr(level)
    for name in ("asyncua", "pymodbus", "can", "canopen"):  # their errors arrive as exceptions
        logging.getLogger(name).setLevel(logging.CRITICAL if verbose < 2 else logging.INFO)


def _with_simulators() -> None:
    """Raises click.UsageError in an installation for a machine, which has no emulated devices."""
    if find_spec("simulators") is None:
        raise click.UsageError(Text(NoticeCode.EMULATED_NOT_INSTALLED).in_language(language_wanted(os.environ)))


@main.command()
@ConfigPath
@click.option("--answers", type=OldFile, help="TOML file with the answers: nothing is asked (docs/wiring.md).")
@click.option("--limit", type=FiniteNumber(min=1), default=SCAN_LIMIT_S, show_default=True,
              help="Scan each wire at most this many seconds.")  # fmt: skip
def init(config: Path, answers: Path | None, limit: float) -> None:
    """Write a first CONFIG: ask for what a scan cannot find, find the devices, arm nothing.

    \b
    Asks for the machine's name, wires and control, scans the wires (reads only), and writes a commented file that
    `check` accepts. Lines that hold a guess say CONFIRM, and are listed; unknown devices are comments with the next
    command. Run again, it proposes the same answers and adds what is missing. It changes no file that it did not write,
    except the untouched example of the Debian package: `scan --toml` adds to those.
    """
    from gateway.commissioning.init import init as begin

    sys.exit(0 if begin(config, answers, limit) else EXIT_WORLD)


@main.command()
@ConfigPath
def check(config: Path) -> None:
    """Check CONFIG without touching the network."""
    from gateway.commissioning.check import checked_lines
    from gateway.config.extended import other_kinds

    checked, (usable, broken) = read_config(config), other_kinds()
    lines = list(checked_lines(config, checked, usable))
    for text in broken:
        click.echo(f"warning: {text}", err=True)
    for line in lines:
        click.echo(line)


@main.command()
@ConfigPath
@click.option("--watch", "watched", is_flag=True, help="Keep reading: value, age, rate, jitter and errors; not the NC.")
@click.option("--seconds", type=FiniteNumber(min=0.1), help="With --watch: stop after this time. Default: at Ctrl-C.")
@click.option("--every", type=FiniteNumber(min=0.1), help="With --watch: seconds between updates.")
@click.option(
    "--try-writing",
    is_flag=True,
    help="Write the present values back to the control: shows whether the gateway may write.",
)
def probe(config: Path, watched: bool, seconds: float | None, every: float | None, try_writing: bool) -> None:
    """Read every device of CONFIG once and show each channel. Publishes nothing, and writes nothing without
    --try-writing.

    \b
    --watch keeps reading at the periods of CONFIG. On a terminal it shows a table: rate and jitter of a device over
    its last 60 answers, lost is the number of periods without an answer, age is the time since the last good value.
    Elsewhere it prints lines: one per device every 10 s, and one for each problem when it begins or ends.
    """
    if watched and try_writing:
        raise click.UsageError("--try-writing and --watch cannot be combined")
    if watched:
        from gateway.commissioning.probe_watch import watch_channels as keep_watching

        sys.exit(0 if keep_watching(read_config(config), seconds, every) else EXIT_WORLD)
    if seconds is not None or every is not None:
        raise click.UsageError("--seconds and --every need --watch")
    from gateway.commissioning.probe import show

    sys.exit(0 if show(read_config(config), try_writing=try_writing) else EXIT_WORLD)


@main.command()
@ConfigPath
@click.option("-o", "--output", type=AnyFile, default=Path("field.wire"),
              show_default=True, help="Text file, one line per message. Must not exist yet.")  # fmt: skip
@click.option("--seconds", type=FiniteNumber(min=0.1), help="Stop after this time. Default: at Ctrl-C.")
@click.option("--most-mb", type=FiniteNumber(min=0.01), default=200.0, show_default=True, help="Stop at this size.")
def record(config: Path, output: Path, seconds: float | None, most_mb: float) -> None:
    """Read the devices of CONFIG as `run` does, and record what passes on their wires for `play`.

    \b
    The file holds time, bus, direction and bytes or CAN frame of each message (docs/wire-log.md). It also holds the
    buses and devices of CONFIG, so that it can be played elsewhere. The NC is not recorded. Nothing is written to any
    device. Exit code 3: no channel could be read at any time.
    """
    from gateway.commissioning.record import record as write_down

    if output.exists():
        raise click.UsageError(f"{output} already exists; recordings are not overwritten, so give another name with -o")
    sys.exit(0 if write_down(read_config(config), output, seconds, most_mb) else EXIT_WORLD)


@main.command()
@click.argument("file", type=OldFile)
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Default: FILE with .play added.")
@click.option("--seconds", type=FiniteNumber(min=0.1), help="Stop after this time. Default: at Ctrl-C.")
@click.option("--multicast", metavar="GROUP:PORT", help="Put CAN on this UDP group of the computer, such as "
              "239.74.163.2:43113, instead of an adapter; any number of programs may read it.")  # fmt: skip
def play(file: Path, folder: Path | None, seconds: float | None, multicast: str | None) -> None:
    """Play the devices of a recording: FILE of `record`, or a CAN log (candump .log, .asc, .blf, .trc, .csv).

    \b
    Serial lines and CAN adapters become pseudo-terminals, linked in the folder under the bus's name; TCP becomes a free
    loopback port. The folder's gateway.toml reads them: use it with probe, run and tests. Each request gets its
    recorded answers in turn with their recorded delays, including late, broken and missing ones. After the last answer
    the sequence starts again.
    """
    _with_simulators()
    from gateway.demo.play import multicast_group
    from gateway.demo.play import play as be_devices

    group = None if multicast is None else parsed("--multicast", multicast_group, multicast)
    be_devices(file, folder or file.with_name(file.name + ".play"), seconds, group)


@main.command()
@ConfigPath
@click.option("--record", "wires", type=AnyFile,
              help="Record what passes on the wires, for `play`; the previous file gets .1 added.")  # fmt: skip
@click.option("--record-mb", type=FiniteNumber(min=0.01), default=100.0, show_default=True,
              help="With --record: start a new file at this size.")  # fmt: skip
def run(config: Path, wires: Path | None, record_mb: float) -> None:
    """Run the gateway of CONFIG until SIGINT or SIGTERM."""
    from gateway.config.telemetry_rules import credential_problems
    from gateway.service.run import run_service

    checked, language = read_config(config), language_wanted(os.environ)
    for problem in credential_problems(checked.telemetry, datetime.now(UTC)):  # no reason not to run the machine
        click.echo(f"warning: {config}: {problem.in_language(language)}", err=True)
    run_service(checked, config, wires, record_mb)


@main.command()
@click.option("--hours", type=FiniteNumber(1, 10_000), default=72.0, show_default=True, help="Simulated hours.")
@click.option("--method", type=click.Choice(["learner", "models"]), help="Learning method. Default: the learner.")
@click.option("--preset", type=click.Choice(["zimmermann-2022", "blaser-2019"]),
              help="A paper's complete system, instead of the learner (docs/method.md).")  # fmt: skip
@click.option("--calibration-hours", type=FiniteNumber(min=1),
              help="For models and presets. Default: 24 h; blaser-2019 6.5 h.")  # fmt: skip
@click.option("--speed", type=FiniteNumber(1, 20000), default=6000.0, show_default=True,
              help="Highest speed of the simulated clock.")  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of weather, loads and sensor noise."
)
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), default=Path("out/demo"), show_default=True)
@click.option("--zenoh-port", type=click.IntRange(1, 65535), default=7447, show_default=True,
              help="Port on which `watch` finds the run.")  # fmt: skip
@click.option("--connect", multiple=True, help="Zenoh endpoint of a listener to publish to from the first frame on.")
@click.option("--plain", is_flag=True, help="One line per event, even on a terminal.")
@click.option(
    "--nc",
    type=click.Choice(["sinumerik", "linuxcnc"]),
    default="sinumerik",
    show_default=True,
    help="The emulated control, or the real LinuxCNC if it is installed (then only --folder applies).",
)
@click.option("--replay", is_flag=True, help="Play the last demo in --folder again, in about a minute, for its page.")
def demo(nc: str, replay: bool, **given: Any) -> None:
    """Run an emulated machine and its gateway over real protocols, on this computer only."""
    _with_simulators()
    if nc == "linuxcnc":
        from gateway.demo.demo_linuxcnc import run_linuxcnc_demo

        run_linuxcnc_demo(given["folder"] / "linuxcnc")
        return
    need_extra("report")
    from gateway.demo.demo import replay_demo, run_demo, wanted

    if replay:
        replay_demo(given["folder"], given["zenoh_port"])
        return
    run_demo(wanted(**given))


@main.command()
@click.argument("config", required=False, type=OldFile)
@click.option("--connect", multiple=True, help=f"Zenoh endpoint. [default: {LOOPBACK}]")
@click.option("--prefix", type=KeyPrefixText(), help=f"[default: {DEFAULT_PREFIX}]")
@click.option("--machine", help="Name of the machine. Default: the one that runs there, if there is only one.")
@LanguageOption
@with_access
def watch(
    config: Path | None,
    connect: tuple[str, ...],
    prefix: str | None,
    machine: str | None,
    language: str,
    access: "Access",
) -> None:
    """Follow a running gateway as an ordinary Zenoh subscriber: the gateway of CONFIG, or the one at --connect."""
    from gateway.listeners.watch.watch import watch as follow
    from gateway.listeners.watch.watch import watch_own
    from gateway.telemetry.session import Access

    if config is None:
        seen = follow(connect or (LOOPBACK,), prefix or DEFAULT_PREFIX, machine, access, language)
    elif connect or prefix or machine or access != Access():
        raise click.UsageError("CONFIG says where and how; give either it or options")
    else:
        seen = watch_own(read_config(config), language)
    sys.exit(0 if seen else EXIT_WORLD)


@main.command()
@serving_options("127.0.0.1:8080", "TLS, users, tolerances (docs/page.md)")
def web(shown: dict[str, Any]) -> None:
    """Serve the page for operators: whether the machine may cut, and why not.

    The page shows the gateway of CONFIG, which runs on this computer, or all that are found at --connect. It only
    reads, unless [operators] in --settings let users give commands. An address beyond this computer needs TLS and
    users in --settings.
    """
    need_extra("web")
    from gateway.listeners.web.serve import WebCommand, serve_pages

    serve_pages(WebCommand(**shown))


@main.command()
@serving_options("127.0.0.1:4840", "nameplates, certificate, users (docs/site.md)")
def opcua(shown: dict[str, Any]) -> None:
    """Show machines to OPC UA clients after OPC UA for Machine Tools (umati), read-only.

    Shows the gateway of CONFIG, which runs on this computer, and the machines that --settings names and --connect
    reaches. No client can change anything. An address beyond this computer needs a certificate and
    users in --settings.
    """
    from gateway.listeners.umati.serve import serve_machines

    serve_machines(**shown)
