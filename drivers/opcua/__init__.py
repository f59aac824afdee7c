"""OPC UA sessions.

The session is not among them: it loads asyncua, half a second and 20 MB, so who needs it takes it from its module.
"""

from drivers.opcua.settings import OpcUaSettings, valid_certificate

__all__ = ["OpcUaSettings", "valid_certificate"]
