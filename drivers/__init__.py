"""Drivers, which read one device or control each. They do not know TALC or the gateway, and never retry or schedule.

Others use the modules and families named here. None is imported: each loads the libraries of its own protocol.
"""

__all__ = [
    "base",
    "build",
    "bus_settings",
    "can",
    "canopen",
    "linuxcnc",
    "micro_epsilon",
    "modbus",
    "nc",
    "opcua",
    "problems",
    "profiles",
    "recognition",
    "section",
    "sinumerik",
    "tap",
]
