"""OPC UA servers whose nodes are channels."""

from drivers.base import Bus, Clock, Driver
from drivers.family import BusKind, DeviceKind, Family, NoOptions, PlacedDevice
from drivers.opcua.profile import OpcUaProfile
from drivers.opcua.settings import OpcUaBusSettings
from drivers.tap import Tap


def _bus(name: str, settings: OpcUaBusSettings, tap: Tap | None) -> Bus:
    from drivers.opcua.bus import OpcUaBus

    return OpcUaBus(name, settings, tap)


def _device(device: PlacedDevice[OpcUaProfile, NoOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.opcua.bus import OpcUaBus
    from drivers.opcua.device import OpcUaDevice

    if not isinstance(bus, OpcUaBus):
        raise device.foreign(bus)
    return OpcUaDevice(device.name, bus, device.profile, device.channels, clock)


FAMILY = Family(
    buses=(BusKind(OpcUaBusSettings, _bus),),
    devices=(DeviceKind(OpcUaProfile, NoOptions, _device),),
)
