"""Emulated devices that behave like real ones on the wire. Each takes physical values from a function."""

from simulators.devices.adam6015 import Adam6015
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.m7015 import M7015
from simulators.devices.me_sensor import MeSensor
from simulators.devices.modbus_servers import DeviceServer, RtuLine, TcpHost
from simulators.devices.playback import PlayedAdapter, PlayedGroup, PlayedHost, PlayedLine
from simulators.devices.played_broker import PlayedBroker
from simulators.devices.script import EXTENDED, Passed, Script, can_script, stream_script, unnumbered
from simulators.devices.slcan_adapter import SlcanAdapter
from simulators.devices.source import ValueSource

__all__ = [
    "EXTENDED",
    "M7015",
    "Adam6015",
    "Cia404Node",
    "DeviceServer",
    "MeSensor",
    "Passed",
    "PlayedAdapter",
    "PlayedBroker",
    "PlayedGroup",
    "PlayedHost",
    "PlayedLine",
    "RtuLine",
    "Script",
    "SlcanAdapter",
    "TcpHost",
    "ValueSource",
    "can_script",
    "stream_script",
    "unnumbered",
]
