"""Checks and builds buses and devices from the fields of a configuration. Uses no network.

Checking imports no library of a bus; building imports those of its kind.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

from drivers import (
    agent,
    can,
    canopen,
    micro_epsilon,
    modbus,
    mqtt,
    opcua,
)  # buses and devices: loaded where they are named
from drivers.agent import AgentBusSettings, AgentProfile
from drivers.base import Bus, Clock, Driver, SetupError
from drivers.can import CanDbcProfile, CanSettings
from drivers.canopen import CanOpenProfile, CanOpenSettings, Cia404Options, Cia404Profile, NodeOptions
from drivers.micro_epsilon import (
    DisplacementOptions,
    MeEthernetProfile,
    MeEthernetSettings,
    MeRs485Profile,
    MeRs485Settings,
)
from drivers.modbus import (
    LAST_ADDRESS,
    ModbusOptions,
    ModbusProfile,
    ModbusRtuSettings,
    ModbusRtuTcpSettings,
    ModbusTcpSettings,
    last_address,
)
from drivers.mqtt import MqttBusSettings, MqttProfile
from drivers.opcua import OpcUaBusSettings, OpcUaProfile
from drivers.problems import read_settings
from drivers.profile import fits_bus
from drivers.profiles import Profile, load_profile
from drivers.section import Section
from drivers.tap import Tap

__all__ = ["BUS_KINDS", "AnyBusSettings", "bus_from_settings", "check_device", "make_device"]


AnyBusSettings = (
    ModbusRtuSettings
    | ModbusRtuTcpSettings
    | ModbusTcpSettings
    | CanOpenSettings
    | CanSettings
    | MeRs485Settings
    | MeEthernetSettings
    | OpcUaBusSettings
    | MqttBusSettings
    | AgentBusSettings
)

BUS_KINDS: Mapping[str, type[AnyBusSettings]] = {settings.bus_kind: settings for settings in get_args(AnyBusSettings)}


class NoOptions(Section):
    """Options of a device type that has none."""


_Options = ModbusOptions | Cia404Options | NodeOptions | DisplacementOptions | NoOptions


def bus_from_settings(name: str, settings: AnyBusSettings, tap: Tap | None = None) -> Bus:  # noqa: C901 - one case a kind
    """The bus that these settings describe. Imports the libraries of its kind."""
    match settings:
        case ModbusRtuSettings():
            return modbus.ModbusRtuBus(name, settings, tap)
        case ModbusRtuTcpSettings():
            return modbus.ModbusRtuTcpBus(name, settings, tap)
        case ModbusTcpSettings():
            return modbus.ModbusTcpBus(name, settings, tap)
        case CanOpenSettings():
            return canopen.CanOpenBus(name, settings, tap)
        case CanSettings():
            return can.CanBus(name, settings, tap)
        case MeRs485Settings():
            return micro_epsilon.MeRs485Bus(name, settings, tap)
        case MeEthernetSettings():
            return micro_epsilon.MeEthernetBus(name, settings, tap)
        case OpcUaBusSettings():
            return opcua.OpcUaBus(name, settings, tap)
        case MqttBusSettings():
            return mqtt.MqttBus(name, settings, tap)
        case AgentBusSettings():
            return agent.AgentBus(name, settings, tap)


def check_device(
    device_name: str,
    bus_name: str,
    settings: AnyBusSettings,
    profile: str | Profile,
    unit: int,
    channels: Mapping[str, int],
    options: Mapping[str, object],
) -> None:
    """Check all that `make_device` checks on a bus with these settings; neither bus nor device is made.

    Raises SetupError naming the bus, the device, the channel and the value.
    """
    _SettingsCheck(device_name, bus_name, type(settings)).check(_loaded(profile), unit, channels, options)


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
    unit: unit id, node id or address on the bus, if its devices have addresses
    channels: channel name to the device's channel number, counted from 0

    Raises SetupError naming the bus, the device, the channel and the value.
    """
    profile = _loaded(profile)
    checked = _SettingsCheck(device_name, bus.name, _class_of(bus)).check(profile, unit, channels, options)
    match profile, bus, checked:
        case ModbusProfile(), modbus.ModbusBus(), ModbusOptions():
            return modbus.ModbusDevice(device_name, bus, profile, unit, channels, checked, clock)
        case Cia404Profile(), canopen.CanOpenBus(), Cia404Options():
            return canopen.Cia404Device(device_name, bus, profile, unit, channels, checked, clock)
        case CanOpenProfile(), canopen.CanOpenBus(), NodeOptions():
            return canopen.CanOpenDevice(device_name, bus, profile, unit, channels, checked, clock)
        case CanDbcProfile(), can.CanBus(), NoOptions():
            return can.CanDbcDevice(device_name, bus, profile, channels, clock)
        case MeRs485Profile(), micro_epsilon.MeRs485Bus(), DisplacementOptions():
            return micro_epsilon.MeRs485Device(device_name, bus, profile, unit, channels, checked, clock)
        case MeEthernetProfile(), micro_epsilon.MeEthernetBus(), DisplacementOptions():
            return micro_epsilon.MeEthernetDevice(device_name, bus, profile, channels, checked, clock)
        case OpcUaProfile(), opcua.OpcUaBus(), NoOptions():
            return opcua.OpcUaDevice(device_name, bus, profile, channels, clock)
        case MqttProfile(), mqtt.MqttBus(), NoOptions():
            return mqtt.MqttDevice(device_name, bus, profile, channels, clock)
        case AgentProfile(), agent.AgentBus(), NoOptions():
            return agent.AgentDevice(device_name, bus, profile, channels, clock)
        case _:
            raise SetupError(f"{type(bus).__name__} is not a bus that was built here", bus=bus.name, device=device_name)


def _class_of(bus: Bus) -> type[AnyBusSettings]:
    if bus.kind not in BUS_KINDS:
        raise SetupError(f"kind {bus.kind!r} is not one of those that are built here", bus=bus.name)
    return BUS_KINDS[bus.kind]


def _loaded(profile: str | Profile) -> Profile:
    return load_profile(profile) if isinstance(profile, str) else profile


@dataclass(frozen=True, slots=True)
class _SettingsCheck:
    """A device on a bus whose settings are being checked."""

    device: str
    bus: str
    settings: type[AnyBusSettings]

    def check(
        self, profile: Profile, unit: int, channels: Mapping[str, int], options: Mapping[str, object]
    ) -> _Options:
        """The device's options, as its profile has them."""
        self._check_address(profile, unit)
        self._check_channels(profile, channels)
        match profile:
            case ModbusProfile():
                return self._modbus(profile, channels, options)
            case Cia404Profile():
                return self._cia404(profile, options)
            case CanOpenProfile():
                return read_settings(NodeOptions, options, bus=self.bus, device=self.device)
            case CanDbcProfile() | OpcUaProfile() | MqttProfile() | AgentProfile():
                return read_settings(NoOptions, options, bus=self.bus, device=self.device)
            case MeRs485Profile() | MeEthernetProfile():
                return read_settings(DisplacementOptions, options, bus=self.bus, device=self.device)

    def _check_address(self, profile: Profile, unit: int) -> None:
        kind, units = self.settings.bus_kind, self.settings.units
        if not fits_bus(profile.buses, kind, self.settings.carries):
            raise self._error(
                f"profile {profile.name} does not fit a {kind} bus", hint=f"it needs {' or '.join(profile.buses)}"
            )
        if units is not None and not units[0] <= unit <= units[1]:
            raise self._error(f"unit = {unit}: expected {units[0]} to {units[1]} on a {kind} bus")

    def _check_channels(self, profile: Profile, channels: Mapping[str, int]) -> None:
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

    def _modbus(
        self, profile: ModbusProfile, channels: Mapping[str, int], options: Mapping[str, object]
    ) -> ModbusOptions:
        where = read_settings(ModbusOptions, options, bus=self.bus, device=self.device)
        last = last_address(profile, channels, where.address_offset)
        if last > LAST_ADDRESS:
            raise self._error(
                f"address_offset = {where.address_offset}: address {last} does not exist",
                hint=f"addresses end at {LAST_ADDRESS}",
            )
        return where

    def _cia404(self, profile: Cia404Profile, options: Mapping[str, object]) -> Cia404Options:
        chosen = read_settings(Cia404Options, options, bus=self.bus, device=self.device)
        if chosen.vendor is not None and chosen.vendor not in profile.vendors:
            known = ", ".join(profile.vendors)
            raise self._error(
                f"vendor = {chosen.vendor!r} is not in profile {profile.name}",
                hint=f"it has {known}" if known else "it has no [vendor] section: leave this option out",
            )
        return chosen

    def _error(self, what: str, *, channel: str = "", hint: str = "") -> SetupError:
        return SetupError(what, bus=self.bus, device=self.device, channel=channel, hint=hint)
