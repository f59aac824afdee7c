"""`talc-gateway command`: gives a running gateway a command and prints its answer."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.cli.arguments import KeyPrefixText, OldFile, with_access
from gateway.cli.exits import EXIT_WORLD
from gateway.config.fields import DEFAULT_PREFIX, LOOPBACK
from gateway.model.commands import CommandName

if TYPE_CHECKING:
    from gateway.telemetry.session import Access


@click.command()
@click.argument("name", type=click.Choice([name.value for name in CommandName]))
@click.option(
    "--as", "operator", required=True, help="Your name in a [[telemetry.operator]] of the gateway's configuration."
)
@click.option("--operator-key", type=OldFile, required=True, help="File with that operator's key.")
@click.option("--connect", multiple=True, help=f"Zenoh endpoint. [default: {LOOPBACK}]")
@click.option("--prefix", type=KeyPrefixText(), default=DEFAULT_PREFIX, show_default=True)
@click.option("--machine", help="Name of the machine. Default: the one that runs there, if there is only one.")
@with_access
def command(
    name: str,
    operator: str,
    operator_key: Path,
    connect: tuple[str, ...],
    prefix: str,
    machine: str | None,
    access: "Access",
) -> None:
    """Give a running gateway a command, and print its answer (docs/commands.md).

    \b
    measure: request a probing cycle before the grid step ends, as soon as nothing blocks it.
    pause: the compensation goes to its declared state and stays there, restarts included.
    resume: the pause ends.
    disarm: the offsets go to zero and stay there, and no cycle is requested, restarts included.
    arm: the disarming ends; nothing is armed that the configuration does not arm.
    reference: drop the reference; the sphere is measured anew while no program runs, and errors count from zero.
    reload: read the configuration again and apply it, unless something in it needs a restart.
    Only operators that the configuration names may give them. Exit code 3: refused or not reached.
    """
    from gateway.telemetry.client import Machine, MachineError
    from gateway.telemetry.command_signer import CommandSigner

    try:
        signer = CommandSigner.of_file(operator, operator_key)
    except (OSError, ValueError) as error:
        raise click.BadParameter(str(error), param_hint="--operator-key") from None
    try:
        followed = Machine(machine, connect=connect or (LOOPBACK,), prefix=prefix, access=access, operator=signer)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
    try:
        with followed:
            answer = followed.give(CommandName(name))
    except MachineError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(EXIT_WORLD)
    click.echo(f"{answer.machine}: {answer.name} accepted: {answer.text}")
