"""The commands `status` and `doctor`: the condition of a gateway, and problems around it."""

import sys
from pathlib import Path

import click

from gateway.cli.arguments import ConfigPath, LanguageOption
from gateway.cli.exits import EXIT_WORLD


@click.command()
@ConfigPath
@click.option("--json", "as_json", is_flag=True, help="One JSON object, for other programs.")
@LanguageOption
def status(config: Path, as_json: bool, language: str) -> None:
    """Show the condition of the gateway of CONFIG, on the computer where it runs. Exit code 3 unless all is well.

    All is well if it runs and decides in time, every channel is good, and nothing is wrong with the control. It reads
    the database and touches no device.
    """
    from gateway.config.file import load
    from gateway.service.status import show

    sys.exit(0 if show(load(config), as_json, language) else EXIT_WORLD)


@click.command()
@ConfigPath
@LanguageOption
def doctor(config: Path, language: str) -> None:
    """Look for what is wrong around the gateway of CONFIG; say why it matters and what to do.

    Exit code 3 if something was found.

    Clock, disk, supply voltage, CAN interfaces, other programs on a serial port, certificates, probing that scatters
    more than at first, sensors that are the same all day. It reads files, and connects only to the router of
    [telemetry].
    """
    from gateway.commissioning.doctor.health import show
    from gateway.config.file import load

    sys.exit(0 if show(load(config), language=language) else EXIT_WORLD)
