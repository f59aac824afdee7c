"""Controls with an agent that speaks the protocol of docs/agent.md, and their values as channels."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.agent.bus import AgentBus
    from drivers.agent.control import AgentControl
    from drivers.agent.device import AgentDevice
    from drivers.agent.greeting import PROTOCOL_VERSION, Capability, Greeting, greeting_of
    from drivers.agent.profile import AgentProfile
    from drivers.agent.settings import (
        AGENT_PORT,
        AGENT_STATES,
        AgentAddress,
        AgentBusSettings,
        AgentRequests,
        AgentSettings,
    )
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("AgentBus",),
            ".control": ("AgentControl",),
            ".device": ("AgentDevice",),
            ".greeting": ("PROTOCOL_VERSION", "Capability", "Greeting", "greeting_of"),
            ".profile": ("AgentProfile",),
            ".settings": (
                "AGENT_PORT",
                "AGENT_STATES",
                "AgentAddress",
                "AgentBusSettings",
                "AgentRequests",
                "AgentSettings",
            ),
        },
    )

__all__ = [
    "AGENT_PORT",
    "AGENT_STATES",
    "PROTOCOL_VERSION",
    "AgentAddress",
    "AgentBus",
    "AgentBusSettings",
    "AgentControl",
    "AgentDevice",
    "AgentProfile",
    "AgentRequests",
    "AgentSettings",
    "Capability",
    "Greeting",
    "greeting_of",
]
