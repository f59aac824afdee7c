"""Controls with an agent that speaks the protocol of docs/agent.md."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.agent.control import AgentControl
    from drivers.agent.greeting import VERSION, Capability, Greeting, greeting_of
    from drivers.agent.settings import DEFAULT_PORT, LARGEST_UM, STATES, AgentAddress, AgentSettings
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".control": ("AgentControl",),
            ".greeting": ("VERSION", "Capability", "Greeting", "greeting_of"),
            ".settings": ("DEFAULT_PORT", "LARGEST_UM", "STATES", "AgentAddress", "AgentSettings"),
        },
    )

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
