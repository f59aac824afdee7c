"""CANopen nodes that follow CiA 404."""

from drivers.canopen.bus import CanObject, CanOpenBus
from drivers.canopen.cia404 import Cia404Device
from drivers.canopen.profile import Cia404Profile
from drivers.canopen.settings import CanOpenSettings, Cia404Options

__all__ = ["CanObject", "CanOpenBus", "CanOpenSettings", "Cia404Device", "Cia404Options", "Cia404Profile"]
