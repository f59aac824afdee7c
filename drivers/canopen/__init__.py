"""CANopen nodes: those that follow CiA 404, and any others by the objects that a profile lists."""

from drivers.canopen.bus import CanObject, CanOpenBus
from drivers.canopen.cia404 import Cia404Device
from drivers.canopen.generic import CanOpenDevice
from drivers.canopen.objects import CanOpenProfile
from drivers.canopen.profile import Cia404Profile
from drivers.canopen.settings import CanOpenSettings, Cia404Options, NodeOptions

__all__ = [
    "CanObject",
    "CanOpenBus",
    "CanOpenDevice",
    "CanOpenProfile",
    "CanOpenSettings",
    "Cia404Device",
    "Cia404Options",
    "Cia404Profile",
    "NodeOptions",
]
