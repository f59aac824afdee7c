"""Checks and builds buses and devices from the fields of a configuration. Uses no network.

Checking imports no library of a bus; building imports those of its kind.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drivers.base import Bus, Clock, Driver, SetupError
from drivers.bus_settings import BusSettings
from drivers.families import BUS_KINDS, BUSES, DEVICES
from drivers.family import PlacedDevice
from drivers.problems import read_settings
from drivers.profile import DeviceProfile, fits_bus
from drivers.profiles import load_profile
from drivers.tap import Tap
from drivers.text import Text

__all__ = ["BUS_KINDS", "bus_from_settings", "check_device", "make_device"]


def bus_from_settings(name: str, settings: BusSettings, tap: Tap | None = None) -> Bus:
    """The bus that these settings describe. Imports the libraries of its kind."""
    return BUSES[settings.bus_kind].make(name, settings, tap)


def check_device(
    device_name: str,
    bus_name: str,
    settings: BusSettings,
    profile: str | DeviceProfile,
    unit: int,
    channels: Mapping[str, int],
    options: Mapping[str, object],
) -> None:
    """Check all that `make_device` checks on a bus with these settings; neither bus nor device is made.

    Raises SetupError naming the bus, the device, the channel and the value.
    """
    _placed(device_name, bus_name, type(settings), _loaded(profile), unit, channels, options)


def make_device(
    device_name: str,
    bus: Bus,
    profile: str | DeviceProfile,
    unit: int,
    channels: Mapping[str, int],
    options: Mapping[str, object],
    clock: Clock,
) -> Driver:
    """The driver of one device on a bus made here.

    profile: a name, the path of a .toml file, or a loaded profile
    unit: unit id, node id or address on the bus, if its devices have addresses
    channels: channel name to the device's channel number, counted from 0

    Raises SetupError naming the bus, the device, the channel and the value.
    """
    profile = _loaded(profile)
    if bus.kind not in BUS_KINDS:
        raise SetupError(Text("bus_kind_foreign", kind=bus.kind), bus=bus.name)
    device = _placed(device_name, bus.name, BUS_KINDS[bus.kind], profile, unit, channels, options)
    return DEVICES[profile.protocol].make(device, bus, clock)


def _loaded(profile: str | DeviceProfile) -> DeviceProfile:
    return load_profile(profile) if isinstance(profile, str) else profile


def _placed(
    name: str,
    bus: str,
    settings: type[BusSettings],
    profile: DeviceProfile,
    unit: int,
    channels: Mapping[str, int],
    options: Mapping[str, object],
) -> PlacedDevice[Any, Any]:
    """The checked device on a bus with such settings. Raises SetupError."""
    kind = DEVICES[profile.protocol]
    unread: PlacedDevice[Any, Any] = PlacedDevice(name, bus, profile, unit, channels, None)
    _check_address(unread, settings)
    _check_channels(unread)
    device = replace(unread, options=read_settings(kind.options, options, bus=bus, device=name))
    kind.check(device)
    return device


def _check_address(device: PlacedDevice[Any, Any], settings: type[BusSettings]) -> None:
    profile, kind, units = device.profile, settings.bus_kind, settings.units
    if not fits_bus(profile.buses, kind, settings.carries):
        raise device.error(
            Text("profile_misfit", profile=profile.name, kind=kind),
            field=("profile",),
            hint=Text("profile_needs", kinds=profile.buses),
        )
    if units is not None and not units[0] <= device.unit <= units[1]:
        raise device.error(
            Text("unit_beyond", unit=device.unit, low=units[0], high=units[1], kind=kind), field=("unit",)
        )


def _check_channels(device: PlacedDevice[Any, Any]) -> None:
    profile = device.profile
    if not device.channels:
        raise device.error(Text("no_channels"), hint=Text("name_one"))
    seen: dict[int, str] = {}
    for channel, number in device.channels.items():
        if not 0 <= number < profile.channels:
            raise device.error(
                Text("channel_absent", number=number, profile=profile.name, last=profile.channels - 1), channel=channel
            )
        if number in seen:
            raise device.error(Text("channel_taken", number=number, by=seen[number]), channel=channel)
        seen[number] = channel
