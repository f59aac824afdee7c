"""Outlets: what gateways publish over Zenoh is forwarded to other systems of the plant, by a process of its own.

A new kind is one file beside `mqtt.py`, with its settings and its outlet, and a line in `settings.py`.
"""

from gateway.outlets.feed import Feed
from gateway.outlets.outlet import Outlet, OutletError, OutletMessage, OutletSettings, Unacceptable
from gateway.outlets.settings import OutletFile, load_outlets
from gateway.outlets.source import GatewaySource

__all__ = [
    "Feed",
    "GatewaySource",
    "Outlet",
    "OutletError",
    "OutletFile",
    "OutletMessage",
    "OutletSettings",
    "Unacceptable",
    "load_outlets",
]
