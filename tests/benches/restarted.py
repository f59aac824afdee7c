"""Restarts a gateway from its database, as far as what it then knows; and replays it."""

from pathlib import Path

from gateway.config.model import GatewayConfig
from gateway.control.replay.stored import ReplayResult, replay
from gateway.control.restart.earlier import EarlierRun, past_of
from gateway.storage.history import History


def restarted(config: GatewayConfig) -> EarlierRun:
    """Restart from the database of this configuration."""
    with History(config.storage.path) as history:
        return past_of(history, config)


def replayed(path: Path) -> ReplayResult:
    """The replay of this database, which is identical."""
    with History(path) as history:
        result = replay(history)
    assert result.identical, result.first
    return result
