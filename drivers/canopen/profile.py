"""CiA 404 profiles: the objects that hold the values, and each vendor's table of status bits."""

from dataclasses import dataclass

from drivers.faults import CodeRule, code_rule
from drivers.toml_table import Table

_FIELD_VALUES = (0x7100, 0x9100)
_STATUS_BITS = 0xFF
"""Object 6150 is an UNSIGNED8."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """Value = raw * scale + offset."""

    scale: float
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Cia404Profile:
    """A CANopen measuring device (CiA 404)."""

    name: str
    title: str
    channels: int
    unit: str
    confirm: tuple[str, ...]
    value_object: int
    """Object that is read: the process value 0x7130 (int16) or 0x9130 (int32), or the field value 0x7100 or 0x9100."""
    field_scaling: Scaling | None
    """Of a field value, which is what the converter sends: no object of the node says what it means, so the profile
    does. None: the node states digits and unit of its process value."""
    sensor_types: frozenset[int]
    """Values of object 0x6110 that are right."""
    unit_code: int | None
    """Value of object 0x6131 that stands for `unit`; None for a field value, which has no such object."""
    vendors: dict[str, tuple[CodeRule, ...]]
    """Rules for the status in object 0x6150, by vendor."""

    @property
    def buses(self) -> tuple[str, ...]:
        return ("canopen",)

    @property
    def value_bytes(self) -> int:
        """Size of the object that is read."""
        return 2 if self.value_object in (0x7100, 0x7130) else 4


def cia404_profile(name: str, table: Table) -> Cia404Profile:
    """Read a profile of `protocol = "cia404"`. Raises SetupError."""
    value, sensor = table.table("value"), table.table("sensor")
    number = int(value.text("object", choices=("7100", "7130", "9100", "9130")), 16)
    of_field = number in _FIELD_VALUES
    if of_field and table.has("physical_unit"):
        raise table.error("physical_unit", "no object says the unit of a field value; leave this table out")
    profile = Cia404Profile(
        name=name,
        title=table.text("title"),
        channels=table.integer("channels", low=1, high=254),
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        value_object=number,
        field_scaling=_scaling(value) if of_field else None,
        sensor_types=frozenset(sensor.integers("types")),
        unit_code=None if of_field else _unit_code(table.table("physical_unit")),
        vendors=_vendors(table.table("vendor")),
    )
    for part in (value, sensor, table):
        part.finish()
    return profile


def _scaling(table: Table) -> Scaling:
    scaling = Scaling(table.number("scale"), table.number("offset", 0.0))
    if scaling.scale == 0:
        raise table.error("scale", "0 would make every value equal")
    return scaling


def _unit_code(table: Table) -> int:
    code = table.integer("code", low=0, high=0xFFFFFFFF)
    table.finish()
    return code


def _vendors(table: Table) -> dict[str, tuple[CodeRule, ...]]:
    vendors = {}
    for vendor in table.names():
        entry = table.table(vendor)
        vendors[vendor] = tuple(code_rule(rule, _STATUS_BITS) for rule in entry.tables("status"))
        entry.finish()
    return vendors
