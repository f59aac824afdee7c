"""MQTT brokers: the connection, which publications use too, and topics as the channels of a device.

The connection loads paho: import it where it is used.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.mqtt.bus import MqttBus, TopicMessage
    from drivers.mqtt.connection import MqttConnection, Publication
    from drivers.mqtt.device import MqttDevice
    from drivers.mqtt.profile import MqttProfile, MqttTopic, TimeUnit, instant_in, number_in
    from drivers.mqtt.settings import MqttBusSettings, MqttServer
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("MqttBus", "TopicMessage"),
            ".connection": ("MqttConnection", "Publication"),
            ".device": ("MqttDevice",),
            ".profile": ("MqttProfile", "MqttTopic", "TimeUnit", "instant_in", "number_in"),
            ".settings": ("MqttBusSettings", "MqttServer"),
        },
    )

__all__ = [
    "MqttBus",
    "MqttBusSettings",
    "MqttConnection",
    "MqttDevice",
    "MqttProfile",
    "MqttServer",
    "MqttTopic",
    "Publication",
    "TimeUnit",
    "TopicMessage",
    "instant_in",
    "number_in",
]
