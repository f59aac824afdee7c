"""Micro-Epsilon displacement sensors on RS-485, and controllers on Ethernet."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.micro_epsilon.ethernet import MeEthernetBus, MeEthernetDevice
    from drivers.micro_epsilon.profile import MeEthernetProfile, MeRs485Profile
    from drivers.micro_epsilon.rs485 import MeRs485Bus, MeRs485Device, decode_counted, decode_float
    from drivers.micro_epsilon.settings import DisplacementOptions, MeEthernetSettings, MeRs485Settings
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".ethernet": ("MeEthernetBus", "MeEthernetDevice"),
            ".profile": ("MeEthernetProfile", "MeRs485Profile"),
            ".rs485": ("MeRs485Bus", "MeRs485Device", "decode_counted", "decode_float"),
            ".settings": ("DisplacementOptions", "MeEthernetSettings", "MeRs485Settings"),
        },
    )

__all__ = [
    "DisplacementOptions",
    "MeEthernetBus",
    "MeEthernetDevice",
    "MeEthernetProfile",
    "MeEthernetSettings",
    "MeRs485Bus",
    "MeRs485Device",
    "MeRs485Profile",
    "MeRs485Settings",
    "decode_counted",
    "decode_float",
]
