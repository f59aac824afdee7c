"""The fields that every profile has."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import AfterValidator, PrivateAttr, model_validator

from drivers.base import Quality
from drivers.faults import Fault
from drivers.readings import total
from drivers.section import Section, wrong
from drivers.text import Text

UNITS = (
    *("degC", "degF", "K"),
    *("nm", "µm", "um", "mm", "m", "µm/m", "rad", "deg"),
    *("V", "mV", "A", "mA", "ohm", "W", "kW", "Hz", "%", "1"),
    *("VA", "kVA", "var", "kvar", "Wh", "kWh", "VAh", "kVAh", "varh", "kvarh"),
    *("Pa", "kPa", "hPa", "bar", "mbar", "N", "kN", "Nm"),
    *("1/min", "mm/s", "m/s", "m/s2", "l/min", "l/h", "m3/h", "kg/h", "l", "m3", "kg", "s", "min", "h"),
)
"""The units that a profile may state; `1` for a pure number."""


def _known(unit: str) -> str:
    if unit not in UNITS:
        raise ValueError(Text("unit_unknown", unit=unit, units=UNITS))
    return unit


Unit = Annotated[str, AfterValidator(_known)]
"""One of `UNITS`."""


class DeviceProfile(Section):
    """Any profile. `name` in the validation context is its name: its file's name without the suffix."""

    title: str
    """What the device is, for a person."""
    unit: Unit
    """Unit of every channel, one of `UNITS`."""
    confirm: tuple[str, ...] = ()
    """Points that no manual confirms: check them on the device."""
    if TYPE_CHECKING:  # each has them as fields, constants or properties

        @property
        def protocol(self) -> str:
            """The protocol by which `drivers.families` knows such profiles."""

        @property
        def buses(self) -> Sequence[str]:
            """Kinds of bus that the device can be on."""

        @property
        def channels(self) -> int:
            """Number of channels."""

    _name: str = PrivateAttr(default="")

    def model_post_init(self, context: Mapping[str, object] | None) -> None:
        """Set the name from the context."""
        if context is not None:
            self._name = str(context["name"])

    @property
    def name(self) -> str:
        """The profile's name in a configuration."""
        return self._name

    @property
    def oldest_s(self) -> float | None:
        """How old a value of the source may be and still be good, if the profile says so."""
        return None

    @property
    def other_file(self) -> tuple[str, Path] | None:
        """Key and path of the file that the profile refers to, if any; the key is also the usual suffix."""
        return None


class LinearValue(Section):
    """How a channel's number becomes its value: number * scale + offset."""

    scale: float = 1.0
    offset: float = 0.0
    unit: Unit = ""
    """Unit of the channel; by default the profile's."""
    low: float | None = None
    """A value below this is `out_of_range`."""
    high: float | None = None
    """A value above this is `out_of_range`."""

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if self.scale == 0:
            raise wrong(Text("zero_scale"), "scale")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise wrong(Text("not_below_high", low=self.low, high=self.high), "low")
        return self

    def value(self, number: float) -> float | Fault:
        """The value, or a fault if it is beyond the limits."""
        value = total(number * self.scale, self.offset)
        if (self.low is not None and value < self.low) or (self.high is not None and value > self.high):
            return Fault(Quality.OUT_OF_RANGE, Text("beyond_profile", value=value))
        return value


def fits_bus(buses: Collection[str], kind: str, carries: str | None) -> bool:
    """Whether a profile that names these kinds of bus describes devices that can be on a bus of this kind.

    carries: the kind of bus whose devices are on it, if that is another one
    """
    return (carries or kind) in buses
