"""The registry of families: which kinds of bus and which protocols of profiles there are.

The families of this package are registered when this module is imported, one of another package when a configuration
uses it. That loads none of their libraries.
"""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, get_args

from drivers.bus_settings import BusSettings
from drivers.family import BusKind, DeviceKind, Family
from drivers.text import Text

_OWN = ("modbus", "canopen", "can", "micro_epsilon", "opcua", "mqtt", "agent")
"""Folders of `drivers` with a module `family`, in the order of the configuration's reference."""

_buses: dict[str, BusKind[Any]] = {}
_settings: dict[str, type[BusSettings]] = {}
_devices: dict[str, DeviceKind[Any, Any]] = {}
BUSES: Mapping[str, BusKind[Any]] = MappingProxyType(_buses)
"""By `kind` of a `[[bus]]`."""
BUS_KINDS: Mapping[str, type[BusSettings]] = MappingProxyType(_settings)
"""The same kinds to their settings."""
DEVICES: Mapping[str, DeviceKind[Any, Any]] = MappingProxyType(_devices)
"""By `protocol` of a profile."""


def register(family: Family) -> None:
    """Add a family, once or again. ValueError: a kind or protocol is another family's."""
    for bus in family.buses:
        kind = bus.settings.bus_kind
        if _buses.setdefault(kind, bus) is not bus:
            raise ValueError(Text("bus_kind_taken", kind=kind))
        _settings[kind] = bus.settings
    for device in family.devices:
        (protocol,) = get_args(device.profile.model_fields["protocol"].annotation)
        if _devices.setdefault(protocol, device) is not device:
            raise ValueError(Text("protocol_taken", protocol=protocol))


for _name in _OWN:
    register(import_module(f"drivers.{_name}.family").FAMILY)
