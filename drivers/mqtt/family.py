"""MQTT brokers whose topics are channels."""

from drivers.base import Bus, Clock, Driver
from drivers.family import BusKind, DeviceKind, Family, NoOptions, PlacedDevice
from drivers.mqtt.profile import MqttProfile
from drivers.mqtt.settings import MqttBusSettings
from drivers.tap import Tap


def _bus(name: str, settings: MqttBusSettings, tap: Tap | None) -> Bus:
    from drivers.mqtt.bus import MqttBus

    return MqttBus(name, settings, tap)


def _device(device: PlacedDevice[MqttProfile, NoOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.mqtt.bus import MqttBus
    from drivers.mqtt.device import MqttDevice

    if not isinstance(bus, MqttBus):
        raise device.foreign(bus)
    return MqttDevice(device.name, bus, device.profile, device.channels, clock)


FAMILY = Family(
    buses=(BusKind(MqttBusSettings, _bus),),
    devices=(DeviceKind(MqttProfile, NoOptions, _device),),
)
