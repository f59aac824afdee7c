"""OPC UA for Machine Tools (umati): a read-only server that shows what gateways publish.

The server itself is not exported here: importing it loads asyncua's server, so import it from its module.
"""

from gateway.umati.model import Nameplate
from gateway.umati.settings import OpcUaServing, ServerSecurity, ShownMachine, check_serving, load_serving
from gateway.umati.values import NodeShown, shown_now

__all__ = [
    "Nameplate",
    "NodeShown",
    "OpcUaServing",
    "ServerSecurity",
    "ShownMachine",
    "check_serving",
    "load_serving",
    "shown_now",
]
