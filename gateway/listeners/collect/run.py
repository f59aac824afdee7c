"""Collects what the gateways of a site have stored, until a signal ends it."""

import logging
import threading
from pathlib import Path

import click

from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.collector import Collector
from gateway.listeners.collect.network import SiteNetwork
from gateway.listeners.collect.places import site_at
from gateway.runtime.signals import set_on_signals


def collect_site(site: str, telemetry: Telemetry, every_s: float, database_password_file: Path | None) -> None:
    """Collect until SIGINT or SIGTERM, and say at the end what was collected. Raises click.UsageError, CollectError.

    site: a folder, or the address of a PostgreSQL database
    """
    if logging.getLogger().level > logging.INFO:
        logging.getLogger("gateway").setLevel(logging.INFO)
    stop = threading.Event()
    try:
        place = site_at(site, database_password_file)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    with place as kept, SiteNetwork(telemetry) as network:
        set_on_signals(stop)
        collector = Collector(network, kept, every_s=every_s)
        click.echo(f"{site}: collecting what gateways at {', '.join(telemetry.connect)} have stored")
        collector.run(stop)
    for name, asked in sorted(collector.machines.items()):
        rows = ", ".join(f"{many} {table}" for table, many in asked.rows.items()) or "nothing new"
        click.echo(f"{name}: {rows}")
