"""`talc-gateway publish`: forwards what gateways publish to other systems of the plant."""

from pathlib import Path

import click

from gateway.cli.arguments import AnyFile


@click.command()
@click.argument("outlets", type=AnyFile)
@click.option("--check", "only_check", is_flag=True, help="Check OUTLETS and end, without using the network.")
def publish(outlets: Path, only_check: bool) -> None:
    """Forward what gateways publish to the systems of OUTLETS, a TOML file: MQTT, InfluxDB (docs/site.md).

    \b
    A separate process that only reads what gateways publish: nothing here can delay or change a machine. A system that
    is away is tried again; meanwhile messages wait in memory, and the oldest are dropped when there are too many. It
    runs until SIGINT or SIGTERM, and says at the end what was sent.
    """
    from gateway.listeners.outlets.forward import checked_outlets, forward

    file = checked_outlets(outlets)
    if only_check:
        names = ", ".join(f"{one.name} ({one.kind})" for one in file.outlets)
        click.echo(f"{outlets}: good. Outlets: {names}")
        return
    forward(outlets, file)
