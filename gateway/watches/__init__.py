"""Periodic checks of the running gateway, with reports: its health, its store, the computer's clock."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.watches.clock import ClockWatch
    from gateway.watches.health import HealthWatch
    from gateway.watches.store import StoreWatch
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".clock": ("ClockWatch",),
            ".health": ("HealthWatch",),
            ".store": ("StoreWatch",),
        },
    )

__all__ = ["ClockWatch", "HealthWatch", "StoreWatch"]
