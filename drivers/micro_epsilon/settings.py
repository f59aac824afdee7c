"""Settings of the buses of Micro-Epsilon sensors and controllers, and the options of a device."""

from typing import ClassVar

from pydantic import Field

from drivers.bus_settings import Baud, HostSettings, Parity, SerialSettings
from drivers.section import Port, Section


class MeRs485Settings(SerialSettings):
    """Micro-Epsilon displacement sensors on RS-485."""

    bus_kind: ClassVar[str] = "me_rs485"
    units: ClassVar[tuple[int, int]] = (2, 126)
    """First and last address on the bus."""
    name_stem: ClassVar[str] = "growth_line"

    baud: Baud = 230_400
    """Bits per second."""
    parity: Parity = "N"
    """None, even or odd. Sensors are delivered with E at 256000 baud or N at 230400."""


class MeEthernetSettings(HostSettings):
    """The data port of a Micro-Epsilon controller on Ethernet."""

    bus_kind: ClassVar[str] = "me_ethernet"
    name_stem: ClassVar[str] = "eddy"
    only_listens: ClassVar[bool] = True

    port: Port = 10001
    """TCP port of the measured values."""


class DisplacementOptions(Section):
    """Options of one sensor in the configuration."""

    range_um: float = Field(gt=0, le=1e6)
    """Measuring range."""
    zero_um: float = 0.0
    """Distance at zero growth; it is subtracted from every value."""
