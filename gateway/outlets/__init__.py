"""Outlets: what gateways publish over Zenoh is forwarded to other systems of the plant, by a separate process.

A new kind is one file: in another package, with its settings and its outlet (docs/extensions.md).
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.outlets.outlet import Outlet, OutletError, OutletMessage, OutletSettings, Unacceptable
    from gateway.outlets.settings import load_outlets
    from gateway.outlets.source import GatewaySource
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".outlet": ("Outlet", "OutletError", "OutletMessage", "OutletSettings", "Unacceptable"),
            ".settings": ("load_outlets",),
            ".source": ("GatewaySource",),
        },
    )

__all__ = [
    "GatewaySource",
    "Outlet",
    "OutletError",
    "OutletMessage",
    "OutletSettings",
    "Unacceptable",
    "load_outlets",
]
