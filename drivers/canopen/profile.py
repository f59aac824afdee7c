"""CiA 404 profiles: the objects that hold the values, and each vendor's table of status bits."""

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from drivers.faults import CodeRule, check_code
from drivers.profile import DeviceProfile
from drivers.section import Section, wrong
from drivers.text import Text

_FIELD_VALUES = ("7100", "9100")
STATUS_BITS: Final = 0xFF
"""Object 6150 is an UNSIGNED8."""


class Scaling(Section):
    """Value = raw * scale + offset."""

    scale: float
    offset: float = 0.0


class ValueObject(Section):
    """Where the values are."""

    object: Literal["7100", "7130", "9100", "9130"]
    """Object that is read: the process value 7130 (int16) or 9130 (int32), or the field value 7100 or 9100."""
    scale: float | None = None
    """Scale of a field value, which is the converter's raw number. No object of the node states its meaning, so the
    profile does. For a process value, the node states digits and unit."""
    offset: float | None = None
    """See scale; None: 0."""

    @model_validator(mode="after")
    def _scaled_once(self) -> Self:
        if self.object not in _FIELD_VALUES:
            for name in ("scale", "offset"):
                if getattr(self, name) is not None:
                    raise wrong(Text("cia404_states_scale"), name)
        elif self.scale is None:
            raise wrong(Text("cia404_no_scale"), "scale")
        elif self.scale == 0:
            raise wrong(Text("zero_scale"), "scale")
        return self


class Sensor(Section):
    """Which sensors must be connected."""

    types: tuple[int, ...]
    """Accepted values of object 6110."""


class PhysicalUnit(Section):
    """The unit that a process value must have."""

    code: int = Field(ge=0, le=0xFFFFFFFF)
    """Value of object 6131 that means the profile's unit."""


class Vendor(Section):
    """What is specific to one vendor."""

    status: tuple[CodeRule, ...] = ()
    """Rules for the status in object 6150, the most specific first."""


class Cia404Profile(DeviceProfile):
    """A CANopen measuring device (CiA 404)."""

    buses: ClassVar[tuple[str, ...]] = ("canopen",)

    protocol: Literal["cia404"]
    """`cia404`."""
    channels: int = Field(ge=1, le=254)
    """Number of inputs."""
    value: ValueObject
    sensor: Sensor
    physical_unit: PhysicalUnit | None = None
    vendors: Mapping[str, Vendor] = Field(default_factory=dict, alias="vendor")
    """May be left out: then any bit of the status means a broken sensor."""

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        of_field = self.value.object in _FIELD_VALUES
        if of_field and self.physical_unit is not None:
            raise wrong(Text("cia404_no_unit"), "physical_unit")
        if not of_field and self.physical_unit is None:
            raise wrong(Text("cia404_no_physical_unit"), "physical_unit")
        for name, vendor in self.vendors.items():
            for number, rule in enumerate(vendor.status):
                check_code(rule, STATUS_BITS, "vendor", name, "status", number)
        return self

    @property
    def value_object(self) -> int:
        """Index of the object that is read."""
        return int(self.value.object, 16)

    @property
    def value_bytes(self) -> int:
        """Size of the object that is read."""
        return 2 if self.value.object in ("7100", "7130") else 4

    @cached_property
    def field_scaling(self) -> Scaling | None:
        """None if the node states it."""
        if self.value.scale is None:
            return None
        return Scaling(scale=self.value.scale, offset=self.value.offset or 0.0)

    @property
    def sensor_types(self) -> frozenset[int]:
        """Accepted values of object 6110."""
        return frozenset(self.sensor.types)

    @property
    def unit_code(self) -> int | None:
        """Value of object 6131 that means `unit`; None for a field value, which has no such object."""
        return None if self.physical_unit is None else self.physical_unit.code
