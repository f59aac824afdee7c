"""The event of a configuration that is in use from now on."""

from dataclasses import dataclass

from gateway.config.model import GatewayConfig
from gateway.model.events import Configured


@dataclass(frozen=True, slots=True, eq=False)
class ConfigurationApplied(Configured):
    """This configuration is now in use: at the start, and after each reload that took effect."""

    config: GatewayConfig
