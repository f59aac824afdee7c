"""`[[bus]]`: where devices are, and how the gateway reads them. There is one section per kind of wire.

The drivers' settings define where a bus is and what its fields may hold; the gateway's own fields are added here.
"""

from typing import Annotated, Literal

from pydantic import Field

from drivers.can import CanSettings
from drivers.canopen import CanOpenSettings
from drivers.micro_epsilon import MeEthernetSettings, MeRs485Settings
from drivers.modbus import ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.section import Positive, Section
from gateway.config.fields import Name


class Polled(Section):
    """How the gateway polls a bus."""

    name: Name
    """Name by which devices and messages refer to the bus."""
    period_s: Positive = 1.0
    """Every device of the bus is read once in each period."""
    read_limit_s: Positive = 10.0
    """How long one whole read of a device may take; after that the bus is closed and opened again."""
    retry_max_periods: int = Field(default=60, ge=1, le=3600)
    """A silent device, or a bus that does not open, is tried again after 1, 2, 4 ... periods, up to this number."""


class ModbusRtuSection(ModbusRtuSettings, Polled):
    """Modbus RTU on a serial line (RS-485)."""

    kind: Literal["modbus_rtu"]
    """`modbus_rtu`."""


class ModbusRtuTcpSection(ModbusRtuTcpSettings, Polled):
    """Modbus RTU over TCP: units on the serial line of a device server, whose TCP port passes on the bytes as they are.

    The server sets speed and parity of the line.
    """

    kind: Literal["modbus_rtu_tcp"]
    """`modbus_rtu_tcp`."""


class MeRs485Section(MeRs485Settings, Polled):
    """Micro-Epsilon displacement sensors on RS-485."""

    kind: Literal["me_rs485"]
    """`me_rs485`."""


class ModbusTcpSection(ModbusTcpSettings, Polled):
    """Modbus TCP to one host, which is a device itself or a gateway to several units."""

    kind: Literal["modbus_tcp"]
    """`modbus_tcp`."""


class MeEthernetSection(MeEthernetSettings, Polled):
    """The data port of a Micro-Epsilon controller on Ethernet."""

    kind: Literal["me_ethernet"]
    """`me_ethernet`."""


class CanOpenSection(CanOpenSettings, Polled):
    """CANopen nodes on a CAN bus."""

    kind: Literal["canopen"]
    """`canopen`."""


class CanSection(CanSettings, Polled):
    """Devices on a CAN bus that send without being asked, named by a DBC file. `timeout_s`: how old a frame may be."""

    kind: Literal["can"]
    """`can`."""


BusSection = Annotated[
    ModbusRtuSection
    | ModbusRtuTcpSection
    | ModbusTcpSection
    | CanOpenSection
    | CanSection
    | MeRs485Section
    | MeEthernetSection,
    Field(discriminator="kind"),
]
