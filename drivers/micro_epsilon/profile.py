"""Profiles of displacement sensors: payload form and scaling."""

from typing import ClassVar, Literal

from pydantic import Field

from drivers.profile import DeviceProfile
from drivers.section import Positive, Section


class StreamValue(Section):
    """How to scale a raw value."""

    full_scale: Positive
    """Raw value at the end of the measuring range."""


class PayloadValue(StreamValue):
    """What the data of an answer mean."""

    payload: Literal["float", "counted"]
    """`float`: two float32, unscaled and scaled. `counted`: u16 counter, u8 number, filler, int32 values (DT6120)."""


class MeRs485Profile(DeviceProfile):
    """A Micro-Epsilon sensor with RS-485 framing."""

    buses: ClassVar[tuple[str, ...]] = ("me_rs485",)

    protocol: Literal["me_rs485"]
    """`me_rs485`."""
    channels: Literal[1]
    """A sensor has one channel."""
    value: PayloadValue


class MeEthernetProfile(DeviceProfile):
    """A Micro-Epsilon controller that streams on Ethernet."""

    buses: ClassVar[tuple[str, ...]] = ("me_ethernet",)

    protocol: Literal["me_ethernet"]
    """`me_ethernet`."""
    channels: int = Field(ge=1, le=32)
    """Number of channels."""
    value: StreamValue
