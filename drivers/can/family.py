"""Devices on a CAN bus that send without being asked, described by a DBC file."""

from drivers.base import Bus, Clock, Driver
from drivers.can.dbc_profile import CanDbcProfile
from drivers.can.settings import CanSettings
from drivers.family import BusKind, DeviceKind, Family, NoOptions, PlacedDevice
from drivers.tap import Tap


def _bus(name: str, settings: CanSettings, tap: Tap | None) -> Bus:
    from drivers.can.bus import CanBus

    return CanBus(name, settings, tap)


def _device(device: PlacedDevice[CanDbcProfile, NoOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.can.bus import CanBus
    from drivers.can.dbc import CanDbcDevice

    if not isinstance(bus, CanBus):
        raise device.foreign(bus)
    return CanDbcDevice(device.name, bus, device.profile, device.channels, clock)


FAMILY = Family(
    buses=(BusKind(CanSettings, _bus),),
    devices=(DeviceKind(CanDbcProfile, NoOptions, _device),),
)
