"""Bus settings that several families share."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from ipaddress import ip_address
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from drivers.section import AnswerTime, HostName, Port, Section, SerialPort, host_and_port, wrong
from drivers.text import Text

Parity = Literal["N", "E", "O"]
SLOWEST_BAUD = 300
FASTEST_BAUD = 4_000_000
BusWire = Literal["serial", "tcp", "mqtt", "can"]
"""A serial line; a TCP connection whose bytes are all that matters; an MQTT broker; a CAN interface."""
Telegrams = Literal["rtu", "numbered"]
"""Modbus RTU; Modbus TCP, whose messages have numbers."""
Baud = Annotated[int, Field(ge=SLOWEST_BAUD, le=FASTEST_BAUD)]


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches this host name or address."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


class Here(NamedTuple):
    """A place on this computer."""

    path: str
    """Of a serial port, for a bus that is on one."""
    port: int
    """Of TCP, for a bus that is a server."""


class AnyBus(Section, ABC):
    """What a bus of any kind is, also of another package: whoever handles buses asks it here. It has no fields."""

    units: ClassVar[tuple[int, int] | None] = None
    """First and last address on the bus. None: its devices have none, and what they state as `unit` means nothing."""
    carries: ClassVar[str | None] = None
    """The kind of bus whose devices are on it, if that is another one."""
    several_per_unit: ClassVar[bool] = False
    """Whether one address may be several devices, each with a profile of other values."""
    only_listens: ClassVar[bool] = False
    """Whether it asks nothing, so that a silent device costs the others no time."""
    unrecorded: ClassVar[str] = ""
    """What it has on the wire, in words, if that is never recorded."""

    @property
    @abstractmethod
    def place(self) -> str:
        """What no two buses may share, such as `host:port`."""

    @property
    def serial_path(self) -> tuple[str, str] | None:
        """Field and path of this computer's serial port, if that is where it is. No other program may open it."""
        return None

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:  # noqa: ARG003 - overridden
        """The fields that say where it is, for the same bus on this computer; None: the field's default.

        Empty: only its package knows what it calls its address.
        """
        return {}

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. May read files."""
        yield from ()

    def timeout_is_age(self, options: Iterable[Mapping[str, object]]) -> bool:  # noqa: ARG002 - overridden
        """Whether a value may be as old as `timeout_s`, where the bus's devices have these options."""
        return False


class BusSettings(AnyBus):
    """Any bus of the gateway's own kinds."""

    bus_kind: ClassVar[str]
    """`kind` of such a bus in a configuration, and of the profiles that fit it."""

    name_stem: ClassVar[str] = "bus"
    """What a scan calls such a bus, followed by a number."""
    wire: ClassVar[BusWire | None] = None
    """On what a recording of it is played. None: it cannot be played."""
    framing: ClassVar[Telegrams | None] = None
    """How a player tells one request from the next, if the bytes say so."""

    timeout_s: AnswerTime = 0.5
    """How long one answer may take at most. Half of the polling period (`period_s`) or less is best."""


class SerialSettings(BusSettings):
    """A serial line."""

    wire: ClassVar[BusWire | None] = "serial"

    port: SerialPort
    """Serial port. Give a udev name (/dev/serial/by-id/...): /dev/ttyUSB0 may be another adapter after a reboot. A
    relative path starts at the configuration's folder. A device server's port is `rfc2217://HOST:PORT` (RFC 2217, which
    sets its speed, parity and stop bits), or `socket://HOST:PORT` (raw TCP; the server sets them)."""
    baud: Baud = 9600
    """Bits per second."""
    parity: Parity = "N"
    """None, even or odd; the same on every device of the bus."""
    stopbits: Literal[1, 2] = 1
    """Stop bits."""
    rs485_rts: Literal["high", "low"] | None = None
    """Level of RTS while sending, for a port whose driver switches the direction of RS-485 by RTS (Linux's TIOCSRS485).
    By default the port is left as it is: most adapters switch by themselves."""
    rs485_before_s: float = Field(default=0.0, ge=0, le=0.1)
    """From switching to sending until the first bit, in whole milliseconds; with `rs485_rts` only."""
    rs485_after_s: float = Field(default=0.0, ge=0, le=0.1)
    """From the last bit until switching back to receiving, in whole milliseconds; with `rs485_rts` only."""

    @property
    def serial_path(self) -> tuple[str, str] | None:
        """None for a port of a device server."""
        return None if self.is_remote else ("port", self.port)

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """A pseudo-terminal has no RTS."""
        return {"port": to.path, "rs485_rts": None, "rs485_before_s": None, "rs485_after_s": None}

    @property
    def is_remote(self) -> bool:
        """Whether the port is one of a device server on the network."""
        return "://" in self.port

    @model_validator(mode="after")
    def _switched(self) -> Self:
        if self.is_remote and self.rs485_rts is not None:
            raise wrong(Text("rts_of_server"), "rs485_rts")
        for field, delay_s in (("rs485_before_s", self.rs485_before_s), ("rs485_after_s", self.rs485_after_s)):
            if delay_s and self.rs485_rts is None:
                raise wrong(Text("delay_without_rts", delay_s=delay_s), field)
        return self

    @property
    def place(self) -> str:
        """The port, which no two buses may share."""
        return self.port


class HostSettings(BusSettings):
    """A port of a host."""

    wire: ClassVar[BusWire | None] = "tcp"

    host: HostName
    """Host name or address."""
    port: Port
    """TCP port."""

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """The loopback."""
        return {"host": "127.0.0.1", "port": to.port}

    @property
    def place(self) -> str:
        """Host and port, which no two buses may share; as in a URL."""
        return host_and_port(self.host, self.port)
