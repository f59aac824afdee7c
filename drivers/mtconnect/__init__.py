"""Controls with an MTConnect agent, which are only read: positions, speeds and states.

`make_mtconnect` makes the driver itself: it loads an HTTP client. `suggest_mtconnect` reads an agent's description for
a first configuration.
"""

from drivers.mtconnect.make import make_mtconnect, suggest_mtconnect
from drivers.mtconnect.settings import AgentUrl, MachineOfAgent, MtConnectSettings
from drivers.mtconnect.suggest import SuggestedItems

__all__ = ["AgentUrl", "MachineOfAgent", "MtConnectSettings", "SuggestedItems", "make_mtconnect", "suggest_mtconnect"]
