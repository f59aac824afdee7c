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


def code_rule(table: Table, within: int = 0xFFFFFFFF) -> CodeRule:
    """Read `{mask, equals, quality, detail}`; `bit = n` is short for mask and equals of that one bit.

    within: the bits that a number can have; SetupError for a rule that could never match
    """
    if table.has("bit"):
        bit = table.integer("bit", low=0, high=within.bit_length() - 1)
        mask = equals = 1 << bit
        if not within & mask:
            raise table.error("bit", f"{bit} is never set; only bits within 0x{within:X} are looked at")
    else:
        mask = table.integer("mask", within, low=1, high=0xFFFFFFFFFFFFFFFF)
        equals = table.integer("equals", low=0, high=0xFFFFFFFFFFFFFFFF)
        if equals & ~(mask & within):
            raise table.error("equals", f"0x{equals:X} never comes; only bits within 0x{mask & within:X} are looked at")
    rule = CodeRule(mask, equals, fault(table))
    table.finish()
    return rule


def fault(table: Table) -> Fault:
    """Read the keys `quality` and `detail`."""
    return Fault(Quality(table.text("quality", choices=_FAULT_QUALITIES)), table.text("detail"))
