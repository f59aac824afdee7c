"""CAN interfaces, and devices that send without being asked."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.can.bus import CanBus, KeptFrame
    from drivers.can.dbc import CanDbcDevice
    from drivers.can.dbc_profile import CanDbcProfile
    from drivers.can.interface import interface_error, open_interface, shut
    from drivers.can.receiver import Receiver
    from drivers.can.settings import CanInterfaceSettings, CanSettings, is_multicast_group
    from drivers.can.survey import CanSurvey, Heard, Stopped
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("CanBus", "KeptFrame"),
            ".dbc": ("CanDbcDevice",),
            ".dbc_profile": ("CanDbcProfile",),
            ".interface": ("interface_error", "open_interface", "shut"),
            ".receiver": ("Receiver",),
            ".settings": (
                "CanInterfaceSettings",
                "CanSettings",
                "is_multicast_group",
            ),
            ".survey": ("CanSurvey", "Heard", "Stopped"),
        },
    )

__all__ = [
    "CanBus",
    "CanDbcDevice",
    "CanDbcProfile",
    "CanInterfaceSettings",
    "CanSettings",
    "CanSurvey",
    "Heard",
    "KeptFrame",
    "Receiver",
    "Stopped",
    "interface_error",
    "is_multicast_group",
    "open_interface",
    "shut",
]
