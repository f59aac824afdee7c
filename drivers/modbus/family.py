"""Modbus: RTU on a serial line or over TCP, and Modbus TCP."""

from drivers.base import Bus, Clock, Driver
from drivers.family import BusKind, DeviceKind, Family, PlacedDevice
from drivers.modbus.inputs import last_address
from drivers.modbus.profile import ModbusProfile
from drivers.modbus.settings import ModbusOptions, ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.modbus.tables import LAST_ADDRESS
from drivers.tap import Tap
from drivers.text import Text


def _rtu(name: str, settings: ModbusRtuSettings, tap: Tap | None) -> Bus:
    from drivers.modbus.rtu import ModbusRtuBus

    return ModbusRtuBus(name, settings, tap)


def _rtu_tcp(name: str, settings: ModbusRtuTcpSettings, tap: Tap | None) -> Bus:
    from drivers.modbus.rtu import ModbusRtuTcpBus

    return ModbusRtuTcpBus(name, settings, tap)


def _tcp(name: str, settings: ModbusTcpSettings, tap: Tap | None) -> Bus:
    from drivers.modbus.bus import ModbusTcpBus
    from drivers.modbus.unnumbered import UnnumberedTcpBus

    if settings.transaction_id == "ignore":
        return UnnumberedTcpBus(name, settings, tap)
    return ModbusTcpBus(name, settings, tap)


def _device(device: PlacedDevice[ModbusProfile, ModbusOptions], bus: Bus, clock: Clock) -> Driver:
    from drivers.modbus.bus import ModbusBus
    from drivers.modbus.device import ModbusDevice

    if not isinstance(bus, ModbusBus):
        raise device.foreign(bus)
    return ModbusDevice(device.name, bus, device.profile, device.unit, device.channels, device.options, clock)


def _check(device: PlacedDevice[ModbusProfile, ModbusOptions]) -> None:
    offset = device.options.address_offset
    last = last_address(device.profile, device.channels, offset)
    if last > LAST_ADDRESS:
        raise device.error(
            Text("modbus_no_address", offset=offset, address=last),
            field=("address_offset",),
            hint=Text("modbus_last_address", last=LAST_ADDRESS),
        )


FAMILY = Family(
    buses=(
        BusKind(ModbusRtuSettings, _rtu),
        BusKind(ModbusRtuTcpSettings, _rtu_tcp),
        BusKind(ModbusTcpSettings, _tcp),
    ),
    devices=(DeviceKind(ModbusProfile, ModbusOptions, _device, _check),),
)
