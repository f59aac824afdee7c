"""Serves machines to OPC UA clients until a signal ends it."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.listeners.umati.settings import ShownMachine, check_serving, load_serving
from gateway.runtime.garbage import freeze_gc
from gateway.runtime.signals import stop_on_signals
from gateway.telemetry.subscriber.places import heard_at
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription

if TYPE_CHECKING:
    from gateway.config.model import GatewayConfig


def serve_machines(
    config: "GatewayConfig | None",
    connect: tuple[str, ...],
    prefix: str | None,
    settings: Path | None,
    host: str,
    port: int,
) -> None:
    """Serve until SIGINT or SIGTERM; prints the server's address. Raises ConfigError, SetupError, OSError.

    config: of a gateway on this computer; None: only what `connect` and the settings say
    """
    serving = load_serving(settings)
    check_serving(host, serving)
    telemetry = heard_at(config, connect, prefix)
    machines = dict(serving.machines)
    if config is not None:
        machines.setdefault(config.machine.name, ShownMachine())
    if not machines:
        raise click.UsageError("there is no machine to show: give CONFIG, or a section [machine.NAME] in --settings")
    site = SiteSeen(telemetry.prefix, machines)

    async def serve() -> None:
        from gateway.listeners.umati.server import MachineToolServer

        stop = asyncio.Event()
        stop_on_signals(stop)
        async with MachineToolServer(site, machines, serving, host, port) as server:
            freeze_gc()
            click.echo(server.url)
            await stop.wait()

    with SiteSubscription(site, telemetry):
        asyncio.run(serve())
