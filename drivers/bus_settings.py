"""Where devices are: the settings of each kind of bus. Made from a configuration's fields, checked, frozen."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from ipaddress import ip_address
from math import isfinite
from typing import TypeVar

from drivers.base import SetupError
from drivers.byte_stream import SerialSettings

CAN_INTERFACES = ("slcan", "socketcan", "udp_multicast", "virtual")
CAN_BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 1_000_000)


def _require(condition: bool, name: str, value: object, expected: str) -> None:
    if not condition:
        raise ValueError(f"{name} = {value!r}: expected {expected}")


def is_multicast_group(text: str) -> bool:
    """Whether that is an address many can listen at: 224.0.0.0 to 239.255.255.255, or IPv6 beginning with ff."""
    try:
        return ip_address(text).is_multicast
    except ValueError:
        return False


def _check_serial(port: str, baud: int, parity: str, stopbits: int) -> None:
    _require(bool(port), "port", port, "a serial port such as /dev/serial/by-id/...")
    _require(300 <= baud <= 4_000_000, "baud", baud, "300 to 4000000")
    _require(parity in ("N", "E", "O"), "parity", parity, "N, E or O")
    _require(stopbits in (1, 2), "stopbits", stopbits, "1 or 2")


def _check_timeout(timeout_s: float) -> None:
    _require(0 < timeout_s <= 60, "timeout_s", timeout_s, "more than 0, at most 60")


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusRtuSettings:
    """A serial line with Modbus RTU units."""

    port: str
    baud: int = 9600
    parity: str = "N"
    stopbits: int = 1
    timeout_s: float = 0.5
    """How long one request may take."""

    def __post_init__(self) -> None:
        _check_serial(self.port, self.baud, self.parity, self.stopbits)
        _check_timeout(self.timeout_s)

    @property
    def serial(self) -> SerialSettings:
        return SerialSettings(self.port, self.baud, self.parity, self.stopbits)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusTcpSettings:
    """A host that speaks Modbus TCP; several units may stand behind it."""

    host: str
    port: int = 502
    timeout_s: float = 1.0

    def __post_init__(self) -> None:
        _require(bool(self.host), "host", self.host, "a host name or address")
        _require(1 <= self.port <= 65535, "port", self.port, "1 to 65535")
        _check_timeout(self.timeout_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class CanInterfaceSettings:
    """How a CAN bus is reached."""

    interface: str
    """One of CAN_INTERFACES."""
    channel: str
    """slcan: serial port; socketcan: interface such as can0; udp_multicast: group address; virtual: any name."""
    bitrate: int = 125_000
    """bit/s. Only slcan sets it; a socketcan interface is set up by the system."""
    timeout_s: float = 0.5
    port: int = 43113
    """UDP port, for udp_multicast only."""

    def __post_init__(self) -> None:
        _require(self.interface in CAN_INTERFACES, "interface", self.interface, f"one of {', '.join(CAN_INTERFACES)}")
        _require(bool(self.channel), "channel", self.channel, "a port, interface or group")
        group = self.interface != "udp_multicast" or is_multicast_group(self.channel)
        _require(group, "channel", self.channel, "a multicast group, such as 239.74.163.2, on udp_multicast")
        _require(self.bitrate in CAN_BITRATES, "bitrate", self.bitrate, f"one of {', '.join(map(str, CAN_BITRATES))}")
        _require(1 <= self.port <= 65535, "port", self.port, "1 to 65535")
        _check_timeout(self.timeout_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class CanOpenSettings(CanInterfaceSettings):
    """A CAN interface with CANopen nodes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanSettings(CanInterfaceSettings):
    """A CAN interface with devices that send by themselves, described by DBC files.

    `timeout_s` is how old a device's last frame may be, so it must be longer than the device's cycle.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class MeRs485Settings:
    """A serial line with Micro-Epsilon sensors."""

    port: str
    baud: int = 230_400
    parity: str = "N"
    """Sensors leave the works with E (8E1) at 256000 baud or N at 230400."""
    stopbits: int = 1
    timeout_s: float = 0.2

    def __post_init__(self) -> None:
        _check_serial(self.port, self.baud, self.parity, self.stopbits)
        _check_timeout(self.timeout_s)

    @property
    def serial(self) -> SerialSettings:
        return SerialSettings(self.port, self.baud, self.parity, self.stopbits)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeEthernetSettings:
    """The data port of a Micro-Epsilon controller."""

    host: str
    port: int = 10001
    timeout_s: float = 0.5

    def __post_init__(self) -> None:
        _require(bool(self.host), "host", self.host, "a host name or address")
        _require(1 <= self.port <= 65535, "port", self.port, "1 to 65535")
        _check_timeout(self.timeout_s)


BusSettings = (
    ModbusRtuSettings | ModbusTcpSettings | CanOpenSettings | CanSettings | MeRs485Settings | MeEthernetSettings
)

BUS_KINDS: Mapping[str, type[BusSettings]] = {
    "modbus_rtu": ModbusRtuSettings,
    "modbus_tcp": ModbusTcpSettings,
    "canopen": CanOpenSettings,
    "can": CanSettings,
    "me_rs485": MeRs485Settings,
    "me_ethernet": MeEthernetSettings,
}

S = TypeVar("S")

_WORDS: Mapping[type, str] = {int: "a whole number", float: "a number", str: "a text"}


def settings_from(kind: type[S], options: Mapping[str, object], *, bus: str = "", device: str = "") -> S:
    """Make a settings dataclass (fields int, float or str) from a configuration's fields.

    Raises SetupError naming bus or device, field and value for an unknown field, a missing one, a wrong type or a
    value out of range.
    """
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    values: dict[str, object] = {}
    for name, value in options.items():
        if name not in known:
            listed = ", ".join(known) or "none"
            raise SetupError(f"unknown option {name!r}", bus=bus, device=device, hint=f"options are: {listed}")
        wanted = known[name].type
        accepted: tuple[type, ...] = (int, float) if wanted is float else (wanted,)  # type: ignore[assignment]
        if not isinstance(value, accepted) or isinstance(value, bool):
            raise SetupError(f"{name} = {value!r}: expected {_WORDS[wanted]}", bus=bus, device=device)  # type: ignore[index]
        if isinstance(value, float) and not isfinite(value):
            raise SetupError(f"{name} = {value}: expected a finite number", bus=bus, device=device)
        values[name] = value
    missing = [n for n, f in known.items() if n not in values and f.default is MISSING and f.default_factory is MISSING]
    if missing:
        raise SetupError(f"{missing[0]} is missing", bus=bus, device=device)
    try:
        return kind(**values)
    except ValueError as error:
        raise SetupError(str(error), bus=bus, device=device) from error
