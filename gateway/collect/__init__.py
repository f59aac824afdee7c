"""Collects what the gateways of a site have stored: each row once, to Parquet files or to PostgreSQL."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.collect.collector import Collector, SiteKept
    from gateway.collect.database_machines import machines_in_database
    from gateway.collect.folder import CollectError
    from gateway.collect.machines import CollectedMachine, machines_in
    from gateway.collect.network import SiteNetwork
    from gateway.collect.places import site_at
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".collector": ("Collector", "SiteKept"),
            ".database_machines": ("machines_in_database",),
            ".folder": ("CollectError",),
            ".machines": ("CollectedMachine", "machines_in"),
            ".network": ("SiteNetwork",),
            ".places": ("site_at",),
        },
    )

__all__ = [
    "CollectError",
    "CollectedMachine",
    "Collector",
    "SiteKept",
    "SiteNetwork",
    "machines_in",
    "machines_in_database",
    "site_at",
]
