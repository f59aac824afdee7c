"""CANopen nodes: those that follow CiA 404, and any others by the objects that a profile lists."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.canopen.bus import CanOpenBus
    from drivers.canopen.cia404 import Cia404Device
    from drivers.canopen.generic import CanOpenDevice
    from drivers.canopen.objects import CanOpenProfile
    from drivers.canopen.place import CanObject
    from drivers.canopen.profile import Cia404Profile
    from drivers.canopen.settings import CanOpenSettings, Cia404Options, NodeOptions
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("CanOpenBus",),
            ".cia404": ("Cia404Device",),
            ".generic": ("CanOpenDevice",),
            ".objects": ("CanOpenProfile",),
            ".place": ("CanObject",),
            ".profile": ("Cia404Profile",),
            ".settings": ("CanOpenSettings", "Cia404Options", "NodeOptions"),
        },
    )

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
