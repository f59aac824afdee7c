"""Rules of a profile that say how a device reports a broken sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

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


@dataclass(frozen=True, slots=True)
class RangeRule:
    """A raw number means a fault from `low` to `high`, both included."""

    low: float
    high: float
    fault: Fault

    def matches(self, number: float) -> bool:
        return self.low <= number <= self.high


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


def range_rule(table: Table, least: int | None, most: int | None) -> RangeRule:
    """Read `{low, high, quality, detail}`; one of the two may be left out, and there is no bound on that side then.

    least, most: between them lie the whole numbers that can come; None: any real number can. SetupError for a rule
    that could never match, or always would
    """
    if least is None or most is None:
        low, high = table.number("low", -inf), table.number("high", inf)
    else:
        low, high = table.integer("low", least, low=least, high=most), table.integer("high", most, low=least, high=most)
        if (low, high) == (least, most):
            raise table.error("low", f"{least} to {most} are all the numbers there are")
    if low > high:
        raise table.error("low", f"{low:g} is above high = {high:g}")
    rule = RangeRule(low, high, fault(table))
    table.finish()
    return rule


def fault(table: Table) -> Fault:
    """Read the keys `quality` and `detail`."""
    return Fault(Quality(table.text("quality", choices=_FAULT_QUALITIES)), table.text("detail"))
