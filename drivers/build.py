"""Makes buses and devices from a configuration's fields. This validates everything and never uses the network."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.base import Bus, Clock, Driver, SetupError
from drivers.can import CanBus, CanDbcDevice, CanDbcProfile, CanSettings
from drivers.canopen import CanOpenBus, CanOpenSettings, Cia404Device, Cia404Options, Cia404Profile
from drivers.micro_epsilon import (
    DisplacementOptions,
    MeEthernetBus,
    MeEthernetDevice,
    MeEthernetProfile,
    MeEthernetSettings,
    MeRs485Bus,
    MeRs485Device,
    MeRs485Profile,
    MeRs485Settings,
)
from drivers.modbus import (
    ModbusBus,
    ModbusDevice,
    ModbusOptions,
    ModbusProfile,
    ModbusRtuBus,
    ModbusRtuSettings,
    ModbusTcpBus,
    ModbusTcpSettings,
)
from drivers.problems import read_settings
from drivers.profiles import Profile, load_profile
from drivers.section import Section
from drivers.tap import Tap

__all__ = ["BUS_KINDS", "BusSettings", "bus_from_settings", "make_bus", "make_device"]

_LAST_ADDRESS = 65535


BusSettings = (
    ModbusRtuSettings | ModbusTcpSettings | CanOpenSettings | CanSettings | MeRs485Settings | MeEthernetSettings
)

BUS_KINDS: Mapping[str, type[BusSettings]] = {
    "modbus_rtu": ModbusRtuSettings,
    "modbus_tcp": ModbusTcpSettings,
    "canopen": CanOpenSettings,
    "can": CanSettings,
    "me_rs485": MeRs485Settings,
    "me_ethernet": MeEthernetSettings,
}


class NoOptions(Section):
    """Options of a device that has none."""


def make_bus(name: str, kind: str, options: Mapping[str, object], tap: Tap | None = None) -> Bus:
    """The bus of that kind (a key of BUS_KINDS); `options` are the fields of its settings class.

    tap: receives everything that passes the wire

    Raises SetupError naming the bus, the field and the value.
    """
    if kind not in BUS_KINDS:
        raise SetupError(f"kind {kind!r} does not exist", bus=name, hint=f"there are {', '.join(BUS_KINDS)}")
    return bus_from_settings(name, read_settings(BUS_KINDS[kind], options, bus=name), tap)


def bus_from_settings(name: str, settings: BusSettings, tap: Tap | None = None) -> Bus:
    """The bus that these settings describe."""
    match settings:
        case ModbusRtuSettings():
            return ModbusRtuBus(name, settings, tap)
        case ModbusTcpSettings():
            return ModbusTcpBus(name, settings, tap)
        case CanOpenSettings():
            return CanOpenBus(name, settings, tap)
        case CanSettings():
            return CanBus(name, settings, tap)
        case MeRs485Settings():
            return MeRs485Bus(name, settings, tap)
        case MeEthernetSettings():
            return MeEthernetBus(name, settings, tap)


def make_device(
    device_name: str,
    bus: Bus,
    profile: str | Profile,
    unit: int,
    channels: Mapping[str, int],
    options: Mapping[str, object],
    clock: Clock,
) -> Driver:
    """The driver of one device on a bus made here.

    profile: a name, the path of a .toml file, or a loaded profile
    unit: unit id, node id or address on the bus
    channels: channel name to the device's channel number, counted from 0

    Raises SetupError naming the bus, the device, the channel and the value.
    """
    if isinstance(profile, str):
        profile = load_profile(profile)
    _Place(device_name, bus).check(profile, unit, channels)
    match profile, bus:
        case ModbusProfile(), ModbusBus():
            where = read_settings(ModbusOptions, options, bus=bus.name, device=device_name)
            device = ModbusDevice(device_name, bus, profile, unit, channels, where, clock)
            if device.last_address > _LAST_ADDRESS:
                raise SetupError(
                    f"address_offset = {where.address_offset}: address {device.last_address} does not exist",
                    bus=bus.name,
                    device=device_name,
                    hint=f"addresses end at {_LAST_ADDRESS}",
                )
            return device
        case Cia404Profile(), CanOpenBus():
            chosen = read_settings(Cia404Options, options, bus=bus.name, device=device_name)
            if chosen.vendor not in profile.vendors:
                raise SetupError(
                    f"vendor = {chosen.vendor!r} is not in profile {profile.name}",
                    bus=bus.name,
                    device=device_name,
                    hint=f"there are {', '.join(profile.vendors)}",
                )
            return Cia404Device(device_name, bus, profile, unit, channels, chosen, clock)
        case CanDbcProfile(), CanBus():
            read_settings(NoOptions, options, bus=bus.name, device=device_name)
            return CanDbcDevice(device_name, bus, profile, channels, clock)
        case MeRs485Profile(), MeRs485Bus():
            growth = read_settings(DisplacementOptions, options, bus=bus.name, device=device_name)
            return MeRs485Device(device_name, bus, profile, unit, channels, growth, clock)
        case MeEthernetProfile(), MeEthernetBus():
            growth = read_settings(DisplacementOptions, options, bus=bus.name, device=device_name)
            return MeEthernetDevice(device_name, bus, profile, channels, growth, clock)
        case _:
            raise SetupError(f"{type(bus).__name__} was not made by make_bus", bus=bus.name, device=device_name)


@dataclass(frozen=True, slots=True)
class _Place:
    """A device on a bus, while it is checked."""

    device: str
    bus: Bus

    def check(self, profile: Profile, unit: int, channels: Mapping[str, int]) -> None:
        kind = self.bus.kind
        if kind not in profile.buses:
            raise self._error(
                f"profile {profile.name} does not fit a {kind} bus", hint=f"it needs {' or '.join(profile.buses)}"
            )
        low, high = self.bus.units
        if not low <= unit <= high:
            raise self._error(f"unit = {unit}: expected {low} to {high} on a {kind} bus")
        if not channels:
            raise self._error("no channels", hint="name at least one")
        seen: dict[int, str] = {}
        for channel, number in channels.items():
            if not 0 <= number < profile.channels:
                raise self._error(
                    f"channel number {number}: {profile.name} has 0 to {profile.channels - 1}", channel=channel
                )
            if number in seen:
                raise self._error(f"channel number {number} is taken by {seen[number]} already", channel=channel)
            seen[number] = channel

    def _error(self, what: str, *, channel: str = "", hint: str = "") -> SetupError:
        return SetupError(what, bus=self.bus.name, device=self.device, channel=channel, hint=hint)
