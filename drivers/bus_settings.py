"""Bus settings that several families share."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import NotEmpty, Port, Section, SerialPort

Parity = Literal["N", "E", "O"]
SLOWEST_BAUD, FASTEST_BAUD = 300, 4_000_000
Baud = Annotated[int, Field(ge=SLOWEST_BAUD, le=FASTEST_BAUD)]


class BusSettings(Section):
    """Any bus."""

    timeout_s: float = Field(default=0.5, gt=0, le=60)
    """How long one answer may take at most. Half of the polling period (`period_s`) or less is best."""


class SerialSettings(BusSettings):
    """A serial line."""

    port: SerialPort
    """Serial port. Give a udev name (/dev/serial/by-id/...): /dev/ttyUSB0 may be another adapter after a reboot. A
    relative path starts at the configuration's folder."""
    baud: Baud = 9600
    """Bits per second."""
    parity: Parity = "N"
    """None, even or odd; the same on every device of the bus."""
    stopbits: Literal[1, 2] = 1
    """Stop bits."""

    @property
    def place(self) -> str:
        """The port, which no two buses may share."""
        return self.port


class HostSettings(BusSettings):
    """A port of a host."""

    host: NotEmpty
    """Host name or address."""
    port: Port
    """TCP port."""

    @property
    def place(self) -> str:
        """Host and port, which no two buses may share."""
        return f"{self.host}:{self.port}"
