"""MQTT brokers: the connection, which publications use too, and topics as the channels of a device.

The connection is not exported here: importing it loads paho, so import it from its module.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.mqtt.bus import MqttBus, TopicMessage
    from drivers.mqtt.device import MqttDevice
    from drivers.mqtt.profile import MqttProfile, MqttTopic, TimeUnit, instant_in, number_in
    from drivers.mqtt.settings import MqttBusSettings, MqttServer
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("MqttBus", "TopicMessage"),
            ".device": ("MqttDevice",),
            ".profile": ("MqttProfile", "MqttTopic", "TimeUnit", "instant_in", "number_in"),
            ".settings": ("MqttBusSettings", "MqttServer"),
        },
    )

__all__ = [
    "MqttBus",
    "MqttBusSettings",
    "MqttDevice",
    "MqttProfile",
    "MqttServer",
    "MqttTopic",
    "TimeUnit",
    "TopicMessage",
    "instant_in",
    "number_in",
]
