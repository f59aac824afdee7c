"""Micro-Epsilon displacement sensors on RS-485, and controllers on Ethernet."""

from drivers.micro_epsilon.ethernet import MeEthernetBus, MeEthernetDevice
from drivers.micro_epsilon.profile import MeEthernetProfile, MeRs485Profile
from drivers.micro_epsilon.rs485 import MeRs485Bus, MeRs485Device, decode_counted, decode_float
from drivers.micro_epsilon.settings import DisplacementOptions, MeEthernetSettings, MeRs485Settings

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
