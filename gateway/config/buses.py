"""`[[bus]]`: where devices are, and how the gateway reads them. There is one section per kind of wire.

The drivers' settings define where a bus is and what its fields may hold; the gateway's own fields are added here.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from drivers.agent import AgentBusSettings
from drivers.can import CanSettings
from drivers.canopen import CanOpenSettings
from drivers.micro_epsilon import MeEthernetSettings, MeRs485Settings
from drivers.modbus import ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.mqtt import MqttBusSettings
from drivers.opcua import OpcUaBusSettings
from gateway.config.credentials import agent_cautions
from gateway.config.extensions import OtherBus
from gateway.config.opcua_cautions import server_cautions
from gateway.config.polled import Polled


class ModbusRtuSection(ModbusRtuSettings, Polled):
    """Modbus RTU on a serial line (RS-485)."""

    kind: Literal["modbus_rtu"]
    """`modbus_rtu`."""


class ModbusRtuTcpSection(ModbusRtuTcpSettings, Polled):
    """Modbus RTU over TCP: units on the serial line of a device server, whose TCP port forwards the bytes unchanged.

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
    """Devices on a CAN bus that send without being asked, described by a DBC file.

    `timeout_s`: how old a frame may be, at most three times `period_s`.
    """

    kind: Literal["can"]
    """`can`."""


class OpcUaSection(OpcUaBusSettings, Polled):
    """An OPC UA server whose nodes are channels."""

    kind: Literal["opcua"]
    """`opcua`."""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Of its certificates and secrets."""
        yield from server_cautions(self, in_the_clear="the password" if self.password_file is not None else "")


class MqttSection(MqttBusSettings, Polled):
    """An MQTT broker whose topics are channels. `period_s`: at least a third of the longest time between messages."""

    kind: Literal["mqtt"]
    """`mqtt`."""


class AgentSection(AgentBusSettings, Polled):
    """A control with an agent whose values are channels, such as LinuxCNC's HAL pins; see docs/agent.md."""

    kind: Literal["agent"]
    """`agent`."""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Of its host and its key."""
        yield from agent_cautions(self)


_Own = (
    ModbusRtuSection
    | ModbusRtuTcpSection
    | ModbusTcpSection
    | CanOpenSection
    | CanSection
    | MeRs485Section
    | MeEthernetSection
    | OpcUaSection
    | MqttSection
    | AgentSection
)
if TYPE_CHECKING:
    BusSection = _Own | OtherBus
else:  # gateway.config.extended adds those of other packages where a file uses them
    BusSection = Annotated[_Own, Field(discriminator="kind")]
