"""Tables of a Modbus profile: scaling, and how a device reports its settings and a broken sensor."""

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from drivers.base import Quality
from drivers.faults import CodeRule, Fault, FaultText, check_code
from drivers.modbus.numbers import BIT_FUNCTIONS, REGISTER_BITS, REGISTER_FUNCTIONS, Order, Span, as_in_manuals
from drivers.section import Section, wrong
from drivers.text import Text

LAST_ADDRESS = 65535


def _of_registers(function: int) -> int:
    if function not in REGISTER_FUNCTIONS:
        raise ValueError(Text("modbus_not_registers", function=function))
    return function


def _of_bits(function: int) -> int:
    if function not in BIT_FUNCTIONS:
        raise ValueError(Text("modbus_not_bits", function=function))
    return function


def _no_manuals_number(address: object) -> object:
    if isinstance(address, int) and address > LAST_ADDRESS and (meant := as_in_manuals(address)):
        raise ValueError(Text("modbus_manual_address", address=address, last=LAST_ADDRESS, meant=meant))
    return address


Address = Annotated[int, BeforeValidator(_no_manuals_number), Field(ge=0, le=LAST_ADDRESS)]
"""Address of a register or bit, counted from 0."""
RegisterFunction = Annotated[int, AfterValidator(_of_registers)]
BitFunction = Annotated[int, AfterValidator(_of_bits)]


class Scaled(Section):
    """How a raw number becomes a value."""

    byte_order: Order = "big"
    """Order of the two bytes in a register; Modbus specifies big."""
    word_order: Order = "big"
    """Order of the registers of a 32-bit or 64-bit number; Modbus does not specify it, and vendors differ."""
    shift: int = Field(default=0, ge=0, le=63)
    """How many of the lowest bits of an integer mean something else; they are left out of the raw number."""
    scale: float = 1.0
    """Value = raw * scale + offset, unless the type code gives the scaling."""
    offset: float = 0.0
    """See scale."""
    scaled_by: Literal["fixed", "type_code"] = "fixed"
    """Whether scale and offset apply, or the scaling of each input's type code."""

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if self.scale == 0:
            raise wrong(Text("zero_scale"), "scale")
        return self


class TypeCode(Section):
    """What one code means: raw low and high correspond to low and high in the profile's unit."""

    code: Address
    """The number in the register."""
    low: float
    """Start of the input's range."""
    high: float
    """End of the input's range."""
    raw_low: float | None = None
    """None: the value for all codes."""
    raw_high: float | None = None
    """None: the value for all codes."""


class TypeCodes(Section):
    """Registers that state which sensor is connected and how it is scaled; checked at every connect."""

    function: RegisterFunction
    """Function code."""
    address: Address
    """Address of channel 0."""
    raw_low: float = 0.0
    """What the device sends at the start of an input's range."""
    raw_high: float = 1.0
    """What the device sends at the end of an input's range."""
    codes: tuple[TypeCode, ...] = Field(alias="code", min_length=1)
    """Every code that this profile can read."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for number, entry in enumerate(self.codes):
            span = self._span(entry)
            if span.low >= span.high:
                raise wrong(Text("not_below_high", low=span.low, high=span.high), "code", number, "low")
            if span.raw_low == span.raw_high:
                what = Text("modbus_flat", raw=span.raw_low)
                raise wrong(what, "code", number, "raw_low")
        return self

    @cached_property
    def spans(self) -> Mapping[int, Span]:
        """Every code with its scaling."""
        return {entry.code: self._span(entry) for entry in self.codes}

    def _span(self, entry: TypeCode) -> Span:
        raw_low = self.raw_low if entry.raw_low is None else entry.raw_low
        raw_high = self.raw_high if entry.raw_high is None else entry.raw_high
        return Span(raw_low, raw_high, entry.low, entry.high)


class FaultBits(FaultText):
    """One bit per channel, from `address` on, set when the device detects a broken sensor."""

    function: BitFunction
    """Function code."""
    address: Address
    """Address of channel 0."""


class StatusRegister(Section):
    """Registers that hold each sensor's state as a number or bits, one for each channel or one for several."""

    function: RegisterFunction
    """Function code."""
    address: Address
    """Address of the first register."""
    stride: int = Field(default=1, ge=0, le=1000)
    """Distance from one status register to the next; 0: all channels have the same one."""
    channels_per_register: int = Field(default=1, ge=1, le=REGISTER_BITS)
    """Channels that share a register."""
    bit_stride: int = Field(default=0, ge=0, lt=REGISTER_BITS)
    """Number of bits from one channel's status to the next channel's in the same register."""
    mask: int | None = Field(default=None, ge=1, le=0xFFFF)
    """The bits of the first channel's status; others are ignored. None: as many as each channel has."""
    good: tuple[int, ...] = (0,)
    """Numbers that mean a sensor in order."""
    rules: tuple[CodeRule, ...] = Field(default=(), alias="rule")
    """Rules for the other numbers, the most specific first."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        shared = self.channels_per_register > 1
        if shared and not self.bit_stride:
            what = Text("modbus_no_stride", channels=self.channels_per_register, bits=REGISTER_BITS)
            raise wrong(what, "bit_stride")
        if self.bit_stride and not shared:
            raise wrong(Text("modbus_stride_alone", stride=self.bit_stride), "bit_stride")
        if never := [code for code in self.good if code & ~self.bits]:
            what = Text("modbus_good_never", number=never[0], mask=self.bits)
            raise wrong(what, "good")
        for number, rule in enumerate(self.rules):
            check_code(rule, self.bits, "rule", number)
        return self

    @property
    def bits(self) -> int:
        """The mask in effect."""
        if self.mask is not None:
            return self.mask
        return (1 << self.bit_stride) - 1 if self.bit_stride else 0xFFFF

    def check_for(self, channels: int) -> None:
        """For validators: raises an error if the status of one of this many channels would not be in a register."""
        last = min(self.channels_per_register, channels) - 1
        highest = self.bits.bit_length() - 1 + last * self.bit_stride
        if highest >= REGISTER_BITS:
            what = Text("modbus_stride_far", stride=self.bit_stride, channel=last, bit=highest)
            raise wrong(what, "status", "bit_stride")

    def register(self, channel: int) -> int:
        """Address of the register that holds the channel's status."""
        return self.address + channel // self.channels_per_register * self.stride

    def code(self, channel: int, register: int) -> int:
        """The channel's status from that register, shifted as if the channel were the register's first."""
        return register >> channel % self.channels_per_register * self.bit_stride & self.bits


class Sentinel(FaultText):
    """A raw number that the device sends instead of a value."""

    raw: float
    """The number."""


class Plausibility(Section):
    """For devices that do not report faults: a value outside, or one changing faster than physics allows, is doubtful.

    This is only a guess: an open input may still show a plausible number.
    """

    low: float
    """Lowest plausible value."""
    high: float
    """Highest plausible value."""
    open_input_low: float | None = None
    """Lowest value that this device is known to show with an open input."""
    open_input_high: float | None = None
    """Highest value that this device is known to show with an open input."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low >= self.high:
            raise wrong(Text("not_below_high", low=self.low, high=self.high), "low")
        if (self.open_input_low is None) != (self.open_input_high is None):
            absent, other = ("low", "high") if self.open_input_low is None else ("high", "low")
            raise wrong(Text("modbus_open_half", other=other), f"open_input_{absent}")
        if self.suspicious is not None and self.suspicious[0] > self.suspicious[1]:
            what = Text("modbus_open_reversed", low=self.suspicious[0], high=self.suspicious[1])
            raise wrong(what, "open_input_low")
        return self

    @property
    def suspicious(self) -> tuple[float, float] | None:
        """Values (low, high) that this device is known to show with an open input."""
        if self.open_input_low is None or self.open_input_high is None:
            return None
        return self.open_input_low, self.open_input_high

    def fault(self, value: float, unit: str) -> Fault | None:
        """What is doubtful about the value; None: nothing."""
        if self.suspicious is not None and self.suspicious[0] <= value <= self.suspicious[1]:
            return Fault(Quality.SENSOR_FAULT, Text("reads_open", value=value, unit=unit))
        if not self.low <= value <= self.high:
            return Fault(Quality.OUT_OF_RANGE, Text("outside", value=value, unit=unit, low=self.low, high=self.high))
        return None


class Judged(Section):
    """How a device reports which sensor an input is set to, and a broken one; for `[value]`, or for one `[[block]]`."""

    type_codes: TypeCodes | None = Field(default=None, alias="type_code")
    fault_bits: FaultBits | None = None
    status: StatusRegister | None = None
    sentinels: tuple[Sentinel, ...] = Field(default=(), alias="sentinel")
    plausibility: Plausibility | None = None
