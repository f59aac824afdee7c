"""Restarts a gateway from its database, as far as what it then knows."""

from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import EarlierRun, past_of
from gateway.storage.history import History


def restarted(config: GatewayConfig) -> EarlierRun:
    """Restart from the database of this configuration."""
    with History(config.storage.path) as history:
        return past_of(history, config)
