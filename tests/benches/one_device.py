"""A configuration of one device on one bus, without a control."""

ONE_DEVICE = """
[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "192.168.0.10"
[[device]]
name = "adam"
bus = "tcp1"
profile = "advantech_adam6015"
[device.channels]
ambient = 0
"""
