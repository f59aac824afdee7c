"""How devices tell a broken sensor: the rules a profile states, as data."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.base import Quality
from drivers.toml_table import Table

_FAULT_QUALITIES = {Quality.SENSOR_FAULT.value, Quality.OUT_OF_RANGE.value}


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with one channel's value."""

    quality: Quality
    detail: str


@dataclass(frozen=True, slots=True)
class CodeRule:
    """A raw number means a fault when `number & mask == equals`."""

    mask: int
    equals: int
    fault: Fault

    def matches(self, number: int) -> bool:
        return number & self.mask == self.equals


def first_fault(rules: Sequence[CodeRule], number: int) -> Fault | None:
    """The fault of the first rule that the number matches; profiles list the most telling rule first."""
    return next((rule.fault for rule in rules if rule.matches(number)), None)


def code_rule(table: Table) -> CodeRule:
    """Read `{mask, equals, quality, detail}`; `bit = n` is short for mask and equals of that one bit."""
    if table.has("bit"):
        mask = equals = 1 << table.integer("bit", low=0, high=31)
    else:
        mask = table.integer("mask", 0xFFFFFFFF, low=1, high=0xFFFFFFFF)
        equals = table.integer("equals", low=0, high=0xFFFFFFFF)
    rule = CodeRule(mask, equals, fault(table))
    table.finish()
    return rule


def fault(table: Table) -> Fault:
    """Read the keys `quality` and `detail`."""
    return Fault(Quality(table.text("quality", choices=_FAULT_QUALITIES)), table.text("detail"))
