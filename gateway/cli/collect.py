"""`talc-gateway collect`: keeps what the gateways of a site have stored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from gateway.cli.arguments import FiniteNumber, KeyPrefixText, OldFile, with_proof
from gateway.config.fields import DEFAULT_PREFIX
from gateway.runtime.extras import need_extra


@click.command()
@click.argument("site", metavar="FOLDER|ADDRESS")
@click.option("--connect", multiple=True, required=True, metavar="ENDPOINT", help="Zenoh endpoint of a gateway or a "
              "router, such as tcp/192.168.1.5:7447; several for a site.")  # fmt: skip
@click.option(
    "--prefix", type=KeyPrefixText(), default=DEFAULT_PREFIX, show_default=True, help="First part of the keys."
)
@click.option("--every", type=FiniteNumber(min=0.1), default=30.0, show_default=True,
              help="Seconds after which a gateway is asked again.")  # fmt: skip
@click.option("--database-password-file", type=OldFile, help="File that contains only the password of ADDRESS's user.")
@with_proof
def collect(
    site: str,
    connect: tuple[str, ...],
    prefix: str,
    every: float,
    database_password_file: Path | None,
    proof: Mapping[str, Any],
) -> None:
    """Keep what all gateways at --connect have stored in FOLDER, as Parquet by table, machine and day, or in the
    PostgreSQL database at ADDRESS, such as postgresql://collector@db.plant.example/site.

    \b
    Asks each gateway for the rows that follow those that are there: none is lost or stored twice, however often
    gateways, routers and this command are stopped or killed (docs/site.md). Gateways may come and go; it tries again
    until SIGINT or SIGTERM, and says at the end what was collected.
    """
    need_extra("postgres" if "://" in site else "parquet")
    from gateway.listeners.collect.run import collect_site
    from gateway.telemetry.subscriber.places import connected_to

    collect_site(site, connected_to(connect, prefix, proof), every, database_password_file)
