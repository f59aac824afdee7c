"""Modbus RTU and TCP."""

from drivers.modbus.bus import ModbusBus, ModbusRtuBus, ModbusTcpBus
from drivers.modbus.device import ModbusDevice, last_address
from drivers.modbus.numbers import Block, NumberFormat
from drivers.modbus.profile import ModbusProfile
from drivers.modbus.settings import ModbusOptions, ModbusRtuSettings, ModbusTcpSettings

__all__ = [
    "Block",
    "ModbusBus",
    "ModbusDevice",
    "ModbusOptions",
    "ModbusProfile",
    "ModbusRtuBus",
    "ModbusRtuSettings",
    "ModbusTcpBus",
    "ModbusTcpSettings",
    "NumberFormat",
    "last_address",
]
