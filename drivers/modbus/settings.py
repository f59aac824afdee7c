"""Settings of a Modbus bus, and the options of a unit."""

from pydantic import Field

from drivers.bus_settings import HostSettings, SerialSettings
from drivers.section import Port, Section


class ModbusRtuSettings(SerialSettings):
    """Modbus RTU on a serial line (RS-485)."""

    local_echo: bool | None = None
    """Whether the adapter receives what it sends itself, as some do on two wires: then that is skipped. By default it
    is seen at the first answer."""


class ModbusTcpSettings(HostSettings):
    """Modbus TCP to one host, which is a device itself or a gateway to several units."""

    port: Port = 502
    """TCP port."""


class ModbusOptions(Section):
    """Options of one Modbus device in the configuration."""

    address_offset: int = Field(default=0, ge=0, le=65535)
    """Added to every address of the profile: the position of a module in a coupler's process image."""
