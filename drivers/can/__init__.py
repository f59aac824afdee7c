"""CAN interfaces, and devices that send without being asked."""

from drivers.can.bus import CanBus
from drivers.can.dbc import CanDbcDevice, CanDbcProfile
from drivers.can.interface import interface_error, open_interface, shut
from drivers.can.receiver import Receiver
from drivers.can.settings import CAN_BITRATES, CAN_INTERFACES, CanInterfaceSettings, CanSettings, is_multicast_group
from drivers.can.survey import CanSurvey, Heard, Stopped

__all__ = [
    "CAN_BITRATES",
    "CAN_INTERFACES",
    "CanBus",
    "CanDbcDevice",
    "CanDbcProfile",
    "CanInterfaceSettings",
    "CanSettings",
    "CanSurvey",
    "Heard",
    "Receiver",
    "Stopped",
    "interface_error",
    "is_multicast_group",
    "open_interface",
    "shut",
]
