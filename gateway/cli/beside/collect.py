"""`talc-gateway collect`: keeps what the gateways of a site have stored."""

import logging
import signal
import threading
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.cli.conventions.arguments import FiniteNumber, KeyPrefixText, PemPath, access_options
from gateway.config.fields import DEFAULT_PREFIX
from gateway.runtime.extras import need_extra

if TYPE_CHECKING:
    from gateway.config.telemetry import Telemetry


@click.command()
@click.argument("site", metavar="FOLDER|ADDRESS")
@click.option("--connect", multiple=True, required=True, metavar="ENDPOINT", help="Zenoh endpoint of a gateway or a "
              "router, such as tcp/192.168.1.5:7447; several for a site.")  # fmt: skip
@click.option(
    "--prefix", type=KeyPrefixText(), default=DEFAULT_PREFIX, show_default=True, help="First part of the keys."
)
@click.option("--every", type=FiniteNumber(min=0.1), default=30.0, show_default=True,
              help="Seconds after which a gateway is asked again.")  # fmt: skip
@click.option("--database-password-file", type=PemPath, help="File that contains only the password of ADDRESS's user.")
@access_options
def collect(
    site: str,
    connect: tuple[str, ...],
    prefix: str,
    every: float,
    authority: Path | None,
    certificate: Path | None,
    key: Path | None,
    user: str | None,
    password_file: Path | None,
    database_password_file: Path | None,
) -> None:
    """Keep what all gateways at --connect have stored in FOLDER, as Parquet by table, machine and day, or in the
    PostgreSQL database at ADDRESS, such as postgresql://collector@db.plant.example/site.

    \b
    Asks each gateway for the rows that follow those that are there: none is lost or stored twice, however often
    gateways, routers and this command are stopped or killed (docs/collect.md). Gateways may come and go; it tries again
    until SIGINT or SIGTERM, and says at the end what was collected.
    """
    need_extra("postgres" if "://" in site else "parquet")
    telemetry = _telemetry(
        connect, prefix, user, password_file, {"authority": authority, "certificate": certificate, "key": key}
    )
    from gateway.listeners.collect.collector import Collector
    from gateway.listeners.collect.network import SiteNetwork
    from gateway.listeners.collect.places import site_at

    if logging.getLogger().level > logging.INFO:
        logging.getLogger("gateway").setLevel(logging.INFO)
    stop = threading.Event()
    try:
        place = site_at(site, database_password_file)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    with place as kept, SiteNetwork(telemetry) as network:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        collector = Collector(network, kept, every_s=every)
        click.echo(f"{site}: collecting what gateways at {', '.join(connect)} have stored")
        collector.run(stop)
    for name, asked in sorted(collector.machines.items()):
        rows = ", ".join(f"{many} {table}" for table, many in asked.rows.items()) or "nothing new"
        click.echo(f"{name}: {rows}")


def _telemetry(
    connect: tuple[str, ...],
    prefix: str,
    user: str | None,
    password_file: Path | None,
    files: Mapping[str, Path | None],
) -> "Telemetry":
    """Where to connect and how. Raises click.UsageError."""
    from pydantic import ValidationError

    from gateway.config.telemetry import Telemetry, TelemetryTls
    from gateway.config.telemetry_rules import credential_problems

    try:
        telemetry = Telemetry(
            listen=(),
            connect=connect,
            prefix=prefix,
            tls=TelemetryTls(**files),
            user=user,
            password_file=password_file,
        )
    except ValidationError as error:
        first = error.errors()[0]
        option = "".join(f"--{part}: " for part in first["loc"][:1])
        raise click.UsageError(option + first["msg"].removeprefix("Value error, ")) from None
    if any(place.encrypted for place in telemetry.connecting) and telemetry.tls.authority is None:
        raise click.UsageError("a tls/… endpoint needs --authority")
    for problem in credential_problems(telemetry, datetime.now(UTC)):
        raise click.UsageError(str(problem))
    return telemetry
