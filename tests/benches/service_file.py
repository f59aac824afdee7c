"""A small configuration that a whole service runs with, and the largest of the valid cases."""

from pathlib import Path

FILE = Path(__file__).parents[1] / "gateway" / "config" / "cases" / "valid" / "gateway.toml"
TEXT = """
[machine]
name = "mill"
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "/nowhere/adapter"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
unit = 1
[device.channels]
bed_front = 0
"""
