"""Moved to gateway.polling; the link still imports it from here."""

from gateway.polling import Breaker

__all__ = ["Breaker"]
