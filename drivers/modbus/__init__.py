"""Modbus RTU, also over TCP, and Modbus TCP."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.modbus.bus import ModbusBus, ModbusTcpBus
    from drivers.modbus.device import ModbusDevice
    from drivers.modbus.inputs import addresses_as_in_manuals, last_address
    from drivers.modbus.numbers import Block, NumberFormat, NumberType, Order, as_in_manuals
    from drivers.modbus.profile import ModbusProfile
    from drivers.modbus.rtu import ModbusRtuBus, ModbusRtuTcpBus
    from drivers.modbus.settings import ModbusOptions, ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
    from drivers.modbus.tables import LAST_ADDRESS
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".bus": ("ModbusBus", "ModbusTcpBus"),
            ".device": ("ModbusDevice",),
            ".inputs": ("addresses_as_in_manuals", "last_address"),
            ".numbers": ("Block", "NumberFormat", "NumberType", "Order", "as_in_manuals"),
            ".profile": ("ModbusProfile",),
            ".rtu": ("ModbusRtuBus", "ModbusRtuTcpBus"),
            ".settings": ("ModbusOptions", "ModbusRtuSettings", "ModbusRtuTcpSettings", "ModbusTcpSettings"),
            ".tables": ("LAST_ADDRESS",),
        },
    )

__all__ = [
    "LAST_ADDRESS",
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
    "addresses_as_in_manuals",
    "as_in_manuals",
    "last_address",
]
