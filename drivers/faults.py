"""Rules in a profile that define how a device reports a broken sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from drivers.base import Quality
from drivers.section import Section, wrong
from drivers.text import Text, shown

_MOST = 0xFFFFFFFFFFFFFFFF


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with one channel's value."""

    quality: Quality
    detail: str


class FaultText(Section):
    """How a table of a profile describes a fault."""

    quality: Literal["sensor_fault", "out_of_range"]
    """Quality of the reading."""
    detail: str
    """The reason, in words for a person."""

    @property
    def fault(self) -> Fault:
        return Fault(Quality(self.quality), Text("of_profile", detail=self.detail))


class CodeRule(FaultText):
    """A raw number means a fault when `number & mask == equals`."""

    bit: int | None = Field(default=None, ge=0)
    """Short for mask and equals of that single bit."""
    mask: int | None = Field(default=None, ge=1, le=_MOST)
    """Bits that count; None: every bit."""
    equals: int | None = Field(default=None, ge=0, le=_MOST)
    """The number that means the fault."""

    @model_validator(mode="after")
    def _said_once(self) -> Self:
        if self.bit is None and self.equals is None:
            raise wrong(Text("rule_empty"), "equals")
        if self.bit is not None and (self.mask is not None or self.equals is not None):
            raise wrong(Text("rule_bit_alone", bit=self.bit), "bit")
        return self

    def matches(self, number: int) -> bool:
        """Whether the number means the fault."""
        if self.bit is not None:
            return bool(number >> self.bit & 1)
        return number & (-1 if self.mask is None else self.mask) == self.equals


class RangeRule(FaultText):
    """A raw number from `low` to `high`, both included, means a fault; an omitted one leaves that side unbounded."""

    low: int | float | None = None
    """Lowest number."""
    high: int | float | None = None
    """Highest number."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low is not None and self.high is not None and self.low > self.high:
            raise wrong(Text("above_high", low=self.low, high=self.high), "low")
        return self

    def matches(self, number: float) -> bool:
        """Whether the number means the fault."""
        return (-inf if self.low is None else self.low) <= number <= (inf if self.high is None else self.high)


def first_fault(rules: Sequence[CodeRule], number: int) -> Fault | None:
    """The fault of the first rule that the number matches; profiles list the most specific rule first."""
    return next((rule.fault for rule in rules if rule.matches(number)), None)


def check_code(rule: CodeRule, within: int, *at: str | int) -> None:
    """For validators: raises an error for a rule that could never match.

    within: the bits that a number can have
    at: where the rule is in the file
    """
    if rule.bit is not None:
        if rule.bit >= within.bit_length():
            raise wrong(
                Text("expected", value=shown(rule.bit), wanted=Text("at_most", limit=within.bit_length() - 1)),
                *at,
                "bit",
            )
        if not within >> rule.bit & 1:
            raise wrong(Text("rule_bit_never", bit=rule.bit, mask=within), *at, "bit")
    looked_at = within if rule.mask is None else rule.mask & within
    if rule.equals is not None and rule.equals & ~looked_at:
        what = Text("rule_never", number=rule.equals, mask=looked_at)
        raise wrong(what, *at, "equals")


def _form(rule: object) -> str:
    return "range" if isinstance(rule, dict) and ("low" in rule or "high" in rule) else "code"


NumberRule = Annotated[Annotated[CodeRule, Tag("code")] | Annotated[RangeRule, Tag("range")], Discriminator(_form)]
"""A rule with low or high is a range; any other is a code."""


@dataclass(frozen=True, slots=True)
class RawNumber:
    """How a device sends a number."""

    name: str
    bits: int
    signed: bool = False
    real: bool = False

    @property
    def mask(self) -> int:
        """Every bit of it."""
        return (1 << self.bits) - 1

    def fault(self, rules: Sequence[CodeRule | RangeRule], number: Any) -> Fault | None:
        """The fault of the first rule that the number, as sent, matches; codes test the bits of a signed one, too."""
        for rule in rules:
            if rule.matches(number & self.mask if isinstance(rule, CodeRule) else number):
                return rule.fault
        return None

    def check(self, rule: CodeRule | RangeRule, *at: str | int) -> None:
        """For validators: raises an error for a rule that could never match, or always would."""
        if isinstance(rule, CodeRule):
            if self.real:
                raise wrong(Text("rule_of_real", name=self.name), *at, "mask")
            check_code(rule, self.mask, *at)
        elif not self.real:
            least = -(1 << self.bits - 1) if self.signed else 0
            most = least + self.mask
            for name, bound in (("low", rule.low), ("high", rule.high)):
                if bound is not None and not isinstance(bound, int):
                    raise wrong(Text("expected", value=shown(bound), wanted=Text("a_whole_number")), *at, name)
                if bound is not None and not least <= bound <= most:
                    raise wrong(Text("not_within", value=bound, low=least, high=most), *at, name)
            if rule.low in (None, least) and rule.high in (None, most):
                raise wrong(Text("rule_of_all", low=least, high=most), *at, "low")
