"""Micro-Epsilon displacement sensors on RS-485, and controllers on Ethernet."""

from drivers.base import Bus, Clock, Driver
from drivers.family import BusKind, DeviceKind, Family, PlacedDevice
from drivers.micro_epsilon.profile import MeEthernetProfile, MeRs485Profile
from drivers.micro_epsilon.settings import DisplacementOptions, MeEthernetSettings, MeRs485Settings
from drivers.tap import Tap


def _rs485(name: str, settings: MeRs485Settings, tap: Tap | None) -> Bus:
    from drivers.micro_epsilon.rs485 import MeRs485Bus

    return MeRs485Bus(name, settings, tap)


def _ethernet(name: str, settings: MeEthernetSettings, tap: Tap | None) -> Bus:
    from drivers.micro_epsilon.ethernet import MeEthernetBus

    return MeEthernetBus(name, settings, tap)


def _sensor(device: PlacedDevice[MeRs485Profile, DisplacementOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.micro_epsilon.rs485 import MeRs485Bus, MeRs485Device

    if not isinstance(bus, MeRs485Bus):
        raise device.foreign(bus)
    return MeRs485Device(device.name, bus, device.profile, device.unit, device.channels, device.options, clock)


def _controller(device: PlacedDevice[MeEthernetProfile, DisplacementOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.micro_epsilon.ethernet import MeEthernetBus, MeEthernetDevice

    if not isinstance(bus, MeEthernetBus):
        raise device.foreign(bus)
    return MeEthernetDevice(device.name, bus, device.profile, device.channels, device.options, clock)


FAMILY = Family(
    buses=(BusKind(MeRs485Settings, _rs485), BusKind(MeEthernetSettings, _ethernet)),
    devices=(
        DeviceKind(MeRs485Profile, DisplacementOptions, _sensor),
        DeviceKind(MeEthernetProfile, DisplacementOptions, _controller),
    ),
)
