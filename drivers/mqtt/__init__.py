"""MQTT brokers: the connection, which publications use too, and topics as the channels of a device.

The connection is not exported here: importing it loads paho, so import it from its module.
"""

from drivers.mqtt.bus import MqttBus, TopicMessage
from drivers.mqtt.device import MqttDevice
from drivers.mqtt.profile import MqttProfile, MqttTopic, TimeUnit, instant_in, number_in
from drivers.mqtt.settings import MqttBusSettings, MqttServer

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
