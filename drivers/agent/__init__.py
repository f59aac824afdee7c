"""Controls with an agent that speaks the protocol of docs/agent.md."""

from drivers.agent.control import STATES, AgentControl
from drivers.agent.greeting import VERSION, Capability, Greeting, greeting_of
from drivers.agent.settings import DEFAULT_PORT, LARGEST_UM, AgentAddress, AgentSettings

__all__ = [
    "DEFAULT_PORT",
    "LARGEST_UM",
    "STATES",
    "VERSION",
    "AgentAddress",
    "AgentControl",
    "AgentSettings",
    "Capability",
    "Greeting",
    "greeting_of",
]
