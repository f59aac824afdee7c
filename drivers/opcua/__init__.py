"""OPC UA sessions, and servers whose nodes are channels.

The session loads asyncua (half a second, 20 MB), the functions for certificates load cryptography (15 MB): import them
where they are used.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.opcua.bus import OpcUaBus
    from drivers.opcua.certificates import application_uri, check_key, valid_certificate
    from drivers.opcua.device import OpcUaDevice
    from drivers.opcua.nodes import NodeName, NodeValue, node_name
    from drivers.opcua.profile import OpcUaProfile
    from drivers.opcua.session import OpcUaNumber, OpcUaSession
    from drivers.opcua.settings import OpcUaBusSettings, OpcUaServer, OpcUaSettings, ServerUrl
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("OpcUaBus",),
            ".certificates": ("application_uri", "check_key", "valid_certificate"),
            ".device": ("OpcUaDevice",),
            ".nodes": ("NodeName", "NodeValue", "node_name"),
            ".profile": ("OpcUaProfile",),
            ".session": ("OpcUaNumber", "OpcUaSession"),
            ".settings": ("OpcUaBusSettings", "OpcUaServer", "OpcUaSettings", "ServerUrl"),
        },
    )

__all__ = [
    "NodeName",
    "NodeValue",
    "OpcUaBus",
    "OpcUaBusSettings",
    "OpcUaDevice",
    "OpcUaNumber",
    "OpcUaProfile",
    "OpcUaServer",
    "OpcUaSession",
    "OpcUaSettings",
    "ServerUrl",
    "application_uri",
    "check_key",
    "node_name",
    "valid_certificate",
]
