"""OPC UA sessions, and servers whose nodes are channels.

The session and the certificates are not exported here: importing them loads asyncua (half a second, 20 MB) and
cryptography (15 MB), so import them from their modules.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.opcua.bus import OpcUaBus
    from drivers.opcua.device import OpcUaDevice
    from drivers.opcua.nodes import NodeName, NodeValue, node_name
    from drivers.opcua.profile import OpcUaProfile
    from drivers.opcua.settings import OpcUaBusSettings, OpcUaServer, OpcUaSettings, ServerUrl
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("OpcUaBus",),
            ".device": ("OpcUaDevice",),
            ".nodes": ("NodeName", "NodeValue", "node_name"),
            ".profile": ("OpcUaProfile",),
            ".settings": ("OpcUaBusSettings", "OpcUaServer", "OpcUaSettings", "ServerUrl"),
        },
    )

__all__ = [
    "NodeName",
    "NodeValue",
    "OpcUaBus",
    "OpcUaBusSettings",
    "OpcUaDevice",
    "OpcUaProfile",
    "OpcUaServer",
    "OpcUaSettings",
    "ServerUrl",
    "node_name",
]
