"""CAN interfaces, and devices that send without being asked."""

from drivers.can.bus import CanBus
from drivers.can.dbc import DBC_ENCODING, CanDbcDevice, CanDbcProfile
from drivers.can.interface import failed, open_interface, shut
from drivers.can.receiver import Receiver
from drivers.can.settings import CAN_BITRATES, CAN_INTERFACES, CanInterfaceSettings, CanSettings, is_multicast_group
from drivers.can.survey import CanSurvey, Heard, Stopped

__all__ = [
    "CAN_BITRATES",
    "CAN_INTERFACES",
    "DBC_ENCODING",
    "CanBus",
    "CanDbcDevice",
    "CanDbcProfile",
    "CanInterfaceSettings",
    "CanSettings",
    "CanSurvey",
    "Heard",
    "Receiver",
    "Stopped",
    "failed",
    "is_multicast_group",
    "open_interface",
    "shut",
]
