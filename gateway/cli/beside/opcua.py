"""`talc-gateway opcua`: shows machines to OPC UA clients. It only listens, so it cannot affect a machine."""

import asyncio
from pathlib import Path

import click

from gateway.cli.conventions.arguments import address_of, heard_options, read_config
from gateway.cli.conventions.signals import stop_on_signals


@click.command()
@heard_options
@click.option("--settings", type=click.Path(dir_okay=False, path_type=Path),
              help="TOML file: nameplates, certificate, users (docs/umati.md).")  # fmt: skip
@click.option("--listen", default="127.0.0.1:4840", show_default=True, metavar="HOST:PORT",
              help="Address of the server.")  # fmt: skip
@click.option("--make-password", is_flag=True, help="Ask for a password, print its hash for --settings, and end.")
def opcua(
    config: Path | None,
    connect: tuple[str, ...],
    prefix: str | None,
    settings: Path | None,
    listen: str,
    make_password: bool,
) -> None:
    """Show machines to OPC UA clients after OPC UA for Machine Tools (umati), read-only.

    Shows the gateway of CONFIG, which runs on this computer, and the machines that --settings names and --connect
    reaches. It only listens: no client can touch a machine. An address beyond this computer needs a certificate and
    users in --settings.
    """
    from gateway.cli.beside.heard import heard_at, print_hash

    if make_password:
        print_hash()
        return
    if config is None and not connect:
        raise click.UsageError("give CONFIG, or --connect ENDPOINT")
    from gateway.listeners.umati.settings import ShownMachine, check_serving, load_serving
    from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription

    host, port = address_of(listen)
    serving = load_serving(settings)
    check_serving(host, serving)
    known = None if config is None else read_config(config)
    telemetry = heard_at(known, connect, prefix)
    machines = dict(serving.machines)
    if known is not None:
        machines.setdefault(known.machine.name, ShownMachine())
    if not machines:
        raise click.UsageError("there is no machine to show: give CONFIG, or a section [machine.NAME] in --settings")
    site = SiteSeen(telemetry.prefix, machines)

    async def serve() -> None:
        from gateway.listeners.umati.server import MachineToolServer

        stop = asyncio.Event()
        stop_on_signals(stop)
        async with MachineToolServer(site, machines, serving, host, port) as server:
            click.echo(server.url)
            await stop.wait()

    with SiteSubscription(site, telemetry):
        asyncio.run(serve())
