"""Settings of a Modbus bus, and the options of a unit."""

from typing import ClassVar, Literal

from pydantic import Field

from drivers.bus_settings import BusSettings, HostSettings, SerialSettings, Telegrams
from drivers.section import Port, Section

LONGEST_SETTLE_S = 8.0


class AskedSettings(BusSettings):
    """Any bus whose units are asked."""

    settle_s: float = Field(default=0.0, ge=0, le=LONGEST_SETTLE_S)
    """After connecting nothing is asked for this long, where a device ignores what comes sooner."""
    rest_ms: int = Field(default=0, ge=0, le=2000)
    """After each answer nothing is asked for this long, where a converter or server needs it; a unit's own `rest_ms` is
    an option of its device."""


class ServerSettings(HostSettings, AskedSettings):
    """Any server."""

    close_between_polls: bool = False
    """Whether the connection is closed after each period, for a server with one client at a time that others ask too.
    """


class LineSettings(AskedSettings):
    """Any line with RTU frames."""

    local_echo: bool | None = None
    """Whether the adapter receives its own transmissions, as some two-wire adapters do; they are then skipped. By
    default the gateway detects this at the first answer."""


class ModbusRtuSettings(SerialSettings, LineSettings):
    """Modbus RTU on a serial line (RS-485)."""

    bus_kind: ClassVar[str] = "modbus_rtu"
    units: ClassVar[tuple[int, int]] = (1, 247)
    """First and last address on the bus."""
    several_per_unit: ClassVar[bool] = True
    framing: ClassVar[Telegrams | None] = "rtu"
    name_stem: ClassVar[str] = "rtu"


class ModbusRtuTcpSettings(ServerSettings, LineSettings):
    """Modbus RTU over TCP: units on the serial line of a device server, whose TCP port forwards the bytes unchanged.

    The server sets speed and parity of the line.
    """

    bus_kind: ClassVar[str] = "modbus_rtu_tcp"
    carries: ClassVar[str | None] = ModbusRtuSettings.bus_kind
    units: ClassVar[tuple[int, int]] = (1, 247)
    """First and last address on the bus."""
    several_per_unit: ClassVar[bool] = True
    framing: ClassVar[Telegrams | None] = "rtu"
    name_stem: ClassVar[str] = "rtu"


class ModbusTcpSettings(ServerSettings):
    """Modbus TCP to one host, which is a device itself or a gateway to several units."""

    bus_kind: ClassVar[str] = "modbus_tcp"
    units: ClassVar[tuple[int, int]] = (0, 255)
    """First and last address on the bus."""
    several_per_unit: ClassVar[bool] = True
    framing: ClassVar[Telegrams | None] = "numbered"
    name_stem: ClassVar[str] = "tcp"

    port: Port = 502
    """TCP port."""
    transaction_id: Literal["check", "ignore"] = "check"
    """`ignore`: for a server that answers in order, but not with the number of the request; answers are then told apart
    as on a serial line."""


class ModbusOptions(Section):
    """Options of one Modbus device in the configuration."""

    address_offset: int = Field(default=0, ge=0, le=65535)
    """Added to every address of the profile: the position of a module in a coupler's process image."""
    rest_ms: int = Field(default=0, ge=0, le=2000)
    """After each answer this unit is not asked for this long. By default the gateway finds out what it needs."""
