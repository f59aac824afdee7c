"""The fields that every profile has."""

from collections.abc import Collection, Mapping
from typing import Annotated

from pydantic import AfterValidator, PrivateAttr

from drivers.section import Section

UNITS = (
    *("degC", "degF", "K"),
    *("nm", "µm", "um", "mm", "m", "µm/m", "rad", "deg"),
    *("V", "mV", "A", "mA", "ohm", "W", "kW", "Hz", "%", "1"),
    *("Pa", "kPa", "hPa", "bar", "mbar", "N", "kN", "Nm"),
    *("1/min", "mm/s", "m/s", "l/min", "m3/h", "s"),
)
"""The units that a profile may state; `1` for a pure number."""
_SAME_DEVICES = {"modbus_rtu_tcp": "modbus_rtu"}
"""Kinds of bus that carry the devices of another kind: behind a device server is a serial line."""


def _known(unit: str) -> str:
    if unit not in UNITS:
        raise ValueError(f"{unit!r} is unknown: expected one of {', '.join(UNITS)}")
    return unit


Unit = Annotated[str, AfterValidator(_known)]
"""One of `UNITS`."""


class DeviceProfile(Section):
    """Any profile. `name` in the validation context is its name: that of its file, without the suffix."""

    title: str
    """What the device is, for a person."""
    unit: Unit
    """Unit of every channel, one of `UNITS`."""
    confirm: tuple[str, ...] = ()
    """Points that no manual confirms: check them on the device."""
    _name: str = PrivateAttr(default="")

    def model_post_init(self, context: Mapping[str, object] | None) -> None:
        """Set the name from the context."""
        if context is not None:
            self._name = str(context["name"])

    @property
    def name(self) -> str:
        """The profile's name in a configuration."""
        return self._name


def fits_bus(buses: Collection[str], kind: str) -> bool:
    """Whether a profile that names these kinds of bus describes devices that can be on a bus of this kind."""
    return _SAME_DEVICES.get(kind, kind) in buses
