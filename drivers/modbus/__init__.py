"""Modbus RTU, also over TCP, and Modbus TCP."""

from drivers.modbus.bus import ModbusBus, ModbusTcpBus
from drivers.modbus.device import ModbusDevice, last_address
from drivers.modbus.numbers import Block, NumberFormat, NumberType, Order
from drivers.modbus.profile import ModbusProfile
from drivers.modbus.rtu import ModbusRtuBus, ModbusRtuTcpBus
from drivers.modbus.settings import ModbusOptions, ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings

__all__ = [
    "Block",
    "ModbusBus",
    "ModbusDevice",
    "ModbusOptions",
    "ModbusProfile",
    "ModbusRtuBus",
    "ModbusRtuSettings",
    "ModbusRtuTcpBus",
    "ModbusRtuTcpSettings",
    "ModbusTcpBus",
    "ModbusTcpSettings",
    "NumberFormat",
    "NumberType",
    "Order",
    "last_address",
]
