"""Collects what the gateways of a site have stored: each row once, to Parquet by table, machine and day."""

from gateway.collect.collector import Collector, MachineAsked
from gateway.collect.folder import CollectError, Commit, SiteFolder
from gateway.collect.machines import CollectedMachine, machines_in
from gateway.collect.network import SiteNetwork
from gateway.collect.progress import CollectProgress

__all__ = [
    "CollectError",
    "CollectProgress",
    "CollectedMachine",
    "Collector",
    "Commit",
    "MachineAsked",
    "SiteFolder",
    "SiteNetwork",
    "machines_in",
]
