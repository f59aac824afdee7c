"""What a gateway knows after a restart."""

from gateway.config import GatewayConfig
from gateway.past import Past, past_of
from gateway.storage import History


def restarted(config: GatewayConfig) -> Past:
    """Restart from the database of this configuration."""
    with History(config.storage.path) as history:
        return past_of(history, config)
