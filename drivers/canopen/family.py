"""CANopen nodes: those that follow CiA 404, and any others by the objects that a profile lists."""

from drivers.base import Bus, Clock, Driver
from drivers.canopen.objects import CanOpenProfile
from drivers.canopen.profile import Cia404Profile
from drivers.canopen.settings import CanOpenSettings, Cia404Options, NodeOptions
from drivers.family import BusKind, DeviceKind, Family, PlacedDevice
from drivers.tap import Tap
from drivers.text import Text


def _bus(name: str, settings: CanOpenSettings, tap: Tap | None) -> Bus:
    from drivers.canopen.bus import CanOpenBus

    return CanOpenBus(name, settings, tap)


def _cia404(device: PlacedDevice[Cia404Profile, Cia404Options], bus: Bus, clock: Clock) -> Driver:
    from drivers.canopen.bus import CanOpenBus
    from drivers.canopen.cia404 import Cia404Device

    if not isinstance(bus, CanOpenBus):
        raise device.foreign(bus)
    return Cia404Device(device.name, bus, device.profile, device.unit, device.channels, device.options, clock)


def _any_node(device: PlacedDevice[CanOpenProfile, NodeOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.canopen.bus import CanOpenBus
    from drivers.canopen.generic import CanOpenDevice

    if not isinstance(bus, CanOpenBus):
        raise device.foreign(bus)
    return CanOpenDevice(device.name, bus, device.profile, device.unit, device.channels, device.options, clock)


def _check_vendor(device: PlacedDevice[Cia404Profile, Cia404Options]) -> None:
    vendor, profile = device.options.vendor, device.profile
    if vendor is not None and vendor not in profile.vendors:
        known = tuple(profile.vendors)
        raise device.error(
            Text("vendor_absent", vendor=vendor, profile=profile.name),
            field=("vendor",),
            hint=Text("vendors_known", names=known) if known else Text("vendor_none"),
        )


FAMILY = Family(
    buses=(BusKind(CanOpenSettings, _bus),),
    devices=(
        DeviceKind(Cia404Profile, Cia404Options, _cia404, _check_vendor),
        DeviceKind(CanOpenProfile, NodeOptions, _any_node),
    ),
)
