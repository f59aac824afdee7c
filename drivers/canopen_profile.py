"""What a CiA 404 profile says: which objects hold the values, and each vendor's table of status bits."""

from dataclasses import dataclass

from drivers.faults import CodeRule, code_rule
from drivers.toml_table import Table

_STATUS_BITS = 0xFF
"""Object 6150 is an UNSIGNED8."""


@dataclass(frozen=True, slots=True)
class Cia404Profile:
    """A CANopen measuring device (CiA 404)."""

    name: str
    title: str
    channels: int
    unit: str
    confirm: tuple[str, ...]
    process_value: int
    """Object that is read: 0x7130 (int16) or 0x9130 (int32)."""
    sensor_types: frozenset[int]
    """Values of object 0x6110 that are right."""
    unit_code: int
    """Value of object 0x6131 that stands for `unit`."""
    vendors: dict[str, tuple[CodeRule, ...]]
    """Rules for the status in object 0x6150, by vendor."""

    @property
    def buses(self) -> tuple[str, ...]:
        return ("canopen",)


def cia404_profile(name: str, table: Table) -> Cia404Profile:
    """Read a profile of `protocol = "cia404"`. Raises SetupError."""
    value, sensor, physical_unit = table.table("value"), table.table("sensor"), table.table("physical_unit")
    profile = Cia404Profile(
        name=name,
        title=table.text("title"),
        channels=table.integer("channels", low=1, high=254),
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        process_value=int(value.text("object", choices=("7130", "9130")), 16),
        sensor_types=frozenset(sensor.integers("types")),
        unit_code=physical_unit.integer("code", low=0, high=0xFFFFFFFF),
        vendors=_vendors(table.table("vendor")),
    )
    for part in (value, sensor, physical_unit, table):
        part.finish()
    return profile


def _vendors(table: Table) -> dict[str, tuple[CodeRule, ...]]:
    vendors = {}
    for vendor in table.names():
        entry = table.table(vendor)
        vendors[vendor] = tuple(code_rule(rule, _STATUS_BITS) for rule in entry.tables("status"))
        entry.finish()
    return vendors
