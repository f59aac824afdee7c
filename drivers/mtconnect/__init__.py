"""Controls with an MTConnect agent, which are only read: positions, speeds and states.

`make_mtconnect` makes the driver itself: it loads an HTTP client. `suggest_mtconnect` reads an agent's description for
a first configuration.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.mtconnect.make import make_mtconnect, suggest_mtconnect
    from drivers.mtconnect.settings import AgentUrl, MachineOfAgent, MtConnectSettings
    from drivers.mtconnect.suggest import SuggestedItems
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".make": ("make_mtconnect", "suggest_mtconnect"),
            ".settings": ("AgentUrl", "MachineOfAgent", "MtConnectSettings"),
            ".suggest": ("SuggestedItems",),
        },
    )

__all__ = ["AgentUrl", "MachineOfAgent", "MtConnectSettings", "SuggestedItems", "make_mtconnect", "suggest_mtconnect"]
