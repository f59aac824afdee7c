"""OPC UA sessions.

The session is not exported here: importing it loads asyncua (half a second, 20 MB), so import it from its module.
"""

from drivers.opcua.settings import OpcUaSettings, valid_certificate

__all__ = ["OpcUaSettings", "valid_certificate"]
