"""Settings of a CAN bus."""

import re
from collections.abc import Iterable, Mapping
from ipaddress import ip_address
from typing import ClassVar, Literal, Self

from pydantic import ValidationInfo, field_validator, model_validator

from drivers.bus_settings import BusSettings, BusWire, Here
from drivers.section import AnswerTime, NotEmpty, Port, name_beside_the_file, wrong
from drivers.text import Text, shown

Interface = Literal["socketcan", "slcan", "udp_multicast", "virtual"]
Bitrate = Literal[10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 1_000_000]
_SYSTEM_NAME = re.compile(r"[^\s/:]{1,15}")
"""Name of a network interface on Linux."""


def is_multicast_group(text: str) -> bool:
    """Whether this is a multicast address: 224.0.0.0 to 239.255.255.255, or IPv6 beginning with ff."""
    try:
        return ip_address(text).is_multicast
    except ValueError:
        return False


class CanInterfaceSettings(BusSettings):
    """Settings of any CAN interface."""

    name_stem: ClassVar[str] = "can"
    wire: ClassVar[BusWire | None] = "can"

    interface: Interface = "socketcan"
    """How the CAN bus is reached: through the kernel, a serial adapter or, for tests, the network or this process."""
    channel: NotEmpty
    """`can0` for socketcan, the serial port for slcan, the group's address for udp_multicast. A serial port's relative
    path starts at the configuration's folder."""
    bitrate: Bitrate = 125_000
    """Bits per second. Only slcan sets it; the system sets up a socketcan interface."""
    port: Port = 43113
    """UDP port, for udp_multicast only."""

    @field_validator("channel")
    @classmethod
    def _beside_the_file(cls, channel: str, info: ValidationInfo) -> str:
        return name_beside_the_file(channel, info) if info.data.get("interface") == "slcan" else channel

    @model_validator(mode="after")
    def _reachable(self) -> Self:
        if self.interface == "udp_multicast" and not is_multicast_group(self.channel):
            raise wrong(Text("can_no_group", value=shown(self.channel)), "channel")
        if self.interface == "socketcan" and _SYSTEM_NAME.fullmatch(self.channel) is None:
            raise wrong(Text("can_no_interface", value=shown(self.channel)), "channel")
        return self

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """An slcan adapter."""
        return {"interface": "slcan", "channel": to.path}

    @property
    def serial_path(self) -> tuple[str, str] | None:
        """The port of an slcan adapter."""
        return ("channel", self.channel) if self.interface == "slcan" else None

    @property
    def place(self) -> str:
        """The interface and channel, which no two buses may share."""
        return f"{self.interface} {self.channel}" + (f":{self.port}" if self.interface == "udp_multicast" else "")


class CanSettings(CanInterfaceSettings):
    """Devices on a CAN bus that send without being asked, described by a DBC file."""

    bus_kind: ClassVar[str] = "can"
    only_listens: ClassVar[bool] = True

    timeout_s: AnswerTime = 0.5
    """How old a frame may be, at most three times `period_s`."""

    def timeout_is_age(self, options: Iterable[Mapping[str, object]]) -> bool:  # noqa: ARG002 - there are none
        """Always."""
        return True
