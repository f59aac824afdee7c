"""Settings of a Modbus bus, and the options of a unit."""

from pydantic import Field

from drivers.bus_settings import HostSettings, SerialSettings
from drivers.section import Port, Section


class ModbusRtuSettings(SerialSettings):
    """Modbus RTU on a serial line (RS-485)."""


class ModbusTcpSettings(HostSettings):
    """Modbus TCP: one host, itself a device or a gateway to several units."""

    port: Port = 502
    """TCP port."""


class ModbusOptions(Section):
    """What a configuration may say about one Modbus device."""

    address_offset: int = Field(default=0, ge=0, le=65535)
    """Added to every address of the profile: where a module stands in a coupler's process image."""
