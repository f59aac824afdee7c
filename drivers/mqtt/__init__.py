"""MQTT brokers: the connection, which publications use too, and topics as the channels of a device.

The connection loads paho: import it where it is used.
"""
