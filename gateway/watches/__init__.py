"""Periodic checks of the running gateway, with reports: its health, its store, the computer's clock."""

from gateway.watches.clock import ClockWatch
from gateway.watches.health import HealthWatch
from gateway.watches.store import StoreWatch

__all__ = ["ClockWatch", "HealthWatch", "StoreWatch"]
