"""Drivers, which read one device or control each. They do not know TALC or the gateway.

They have no schedule: the gateway decides when a device is read, and when one that failed is read again.

Others use the modules and families named here. None is imported: each loads the libraries of its own protocol.
"""

__all__ = [
    "agent",
    "base",
    "build",
    "bus_settings",
    "can",
    "canopen",
    "credential_files",
    "error_words",
    "first_use",
    "hang_up",
    "linuxcnc",
    "micro_epsilon",
    "modbus",
    "mqtt",
    "mtconnect",
    "nc",
    "number_types",
    "only_read",
    "opcua",
    "problems",
    "profiles",
    "recognition",
    "section",
    "server_url",
    "signature",
    "sinumerik",
    "tap",
]
