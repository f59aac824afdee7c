"""`[[bus]]`: where devices are. One section per kind of wire."""

from typing import Annotated, Literal

from pydantic import Field

from gateway.config.fields import Name, Positive, Section


class _Bus(Section):
    name: Name
    """Name that devices refer to and messages use."""
    period_s: Positive = 1.0
    """Every device of the bus is read once in each period."""
    timeout_s: float = Field(default=0.5, gt=0, le=60)
    """How long one answer may take at most; best is half of `period_s` or less."""
    read_limit_s: Positive = 10.0
    """How long one device may take for a whole read; after that the bus is closed and opened again."""
    retry_max_periods: int = Field(default=60, ge=1, le=3600)
    """A silent device, or a bus that does not open, is tried again after 1, 2, 4 ... periods, at most this many."""

    def options(self) -> dict[str, object]:
        """What the driver's settings class takes: everything but the name and the gateway's own policy."""
        return self.model_dump(exclude={"name", "kind", "period_s", "read_limit_s", "retry_max_periods"})


class _SerialBus(_Bus):
    port: str = Field(min_length=1)
    """Serial port. Give a udev name (/dev/serial/by-id/...): /dev/ttyUSB0 may be another adapter after a reboot."""
    baud: int = Field(default=9600, ge=1200, le=4_000_000)
    """Bits per second."""
    parity: Literal["N", "E", "O"] = "N"
    """None, even or odd; the same on every device of the bus."""
    stopbits: Literal[1, 2] = 1
    """Stop bits."""

    @property
    def place(self) -> str:
        """What two buses may not share."""
        return self.port


class ModbusRtuBus(_SerialBus):
    """Modbus RTU on a serial line (RS-485)."""

    kind: Literal["modbus_rtu"]
    """`modbus_rtu`."""


class MeRs485Bus(_SerialBus):
    """Micro-Epsilon displacement sensors on RS-485."""

    kind: Literal["me_rs485"]
    """`me_rs485`."""
    baud: int = Field(default=230400, ge=1200, le=4_000_000)
    """Bits per second."""


class ModbusTcpBus(_Bus):
    """Modbus TCP: one host, itself a device or a gateway to several units."""

    kind: Literal["modbus_tcp"]
    """`modbus_tcp`."""
    host: str = Field(min_length=1)
    """Host name or address."""
    port: int = Field(default=502, ge=1, le=65535)
    """TCP port."""

    @property
    def place(self) -> str:
        """What two buses may not share."""
        return f"{self.host}:{self.port}"


class MeEthernetBus(_Bus):
    """The data port of a Micro-Epsilon controller on Ethernet."""

    kind: Literal["me_ethernet"]
    """`me_ethernet`."""
    host: str = Field(min_length=1)
    """Host name or address."""
    port: int = Field(default=10001, ge=1, le=65535)
    """TCP port of the measured values."""

    @property
    def place(self) -> str:
        """What two buses may not share."""
        return f"{self.host}:{self.port}"


class _CanInterface(_Bus):
    interface: Literal["socketcan", "slcan", "udp_multicast", "virtual"] = "socketcan"
    """How the CAN bus is reached: the kernel, a serial adapter, or (for tests) the network or this process."""
    channel: str = Field(min_length=1)
    """`can0` for socketcan, the serial port for slcan, the group's address for udp_multicast."""
    bitrate: Literal[10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 1_000_000] = 125_000
    """Bits per second. Only slcan sets it; a socketcan interface is set up by the system."""
    port: int = Field(default=43113, ge=1, le=65535)
    """UDP port, for udp_multicast only."""

    @property
    def place(self) -> str:
        """What two buses may not share."""
        return f"{self.interface} {self.channel}" + (f":{self.port}" if self.interface == "udp_multicast" else "")


class CanopenBus(_CanInterface):
    """CANopen nodes on a CAN bus."""

    kind: Literal["canopen"]
    """`canopen`."""


class CanBus(_CanInterface):
    """Devices on a CAN bus that send by themselves, named by a DBC file. `timeout_s`: how old a frame may be."""

    kind: Literal["can"]
    """`can`."""


Bus = Annotated[
    ModbusRtuBus | ModbusTcpBus | CanopenBus | CanBus | MeRs485Bus | MeEthernetBus,
    Field(discriminator="kind"),
]
