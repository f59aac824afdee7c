"""Modbus profiles: which numbers and bits of a device are its channels."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from drivers.faults import Fault
from drivers.modbus.numbers import (
    BIT_FUNCTIONS,
    REGISTER_BITS,
    REGISTER_FUNCTIONS,
    AddressRange,
    NumberFormat,
    NumberType,
    registers_of,
)
from drivers.modbus.tables import Address, Judged, RegisterFunction, Scaled
from drivers.number_types import check_shift
from drivers.profile import DeviceProfile, Unit
from drivers.section import Section, wrong
from drivers.text import Text

_MOST_CHANNELS = 1000
_MOST_BITS = 2000
"""Of one answer."""


class Values(Scaled):
    """Where the measured values are, of a device whose channels are all alike. Channel i is at `address + i * stride`.

    It is the short form of one `[[block]]`.
    """

    function: RegisterFunction
    """Function code."""
    address: Address
    """Address of channel 0."""
    type: NumberType
    """How registers hold a number."""
    stride: int = Field(default_factory=lambda data: registers_of(data.get("type")), ge=1, le=1000)
    """Distance from one channel to the next; by default there is no gap."""

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if self.stride < (least := registers_of(self.type)):
            raise wrong(Text("modbus_stride", stride=self.stride, least=least, type=self.type), "stride")
        check_shift(self.shift, self.type)
        return self


class ChannelBlock(Scaled, Judged):
    """Channels of one kind: one function, type, scaling and unit. Addresses and status tables count its own channels.

    The channels of a device are numbered through its blocks, in the order of the file.
    """

    function: int = Field(ge=1, le=4)
    """Function code: 1 and 2 read bits, 3 and 4 registers."""
    address: Address | None = None
    """Address of the block's first channel; channel i is at `address + i * stride`."""
    addresses: tuple[Address, ...] = Field(default=(), max_length=_MOST_CHANNELS)
    """Instead of address, channels and stride: the address of each channel, where they are at irregular distances."""
    count: int | None = Field(default=None, alias="channels", ge=1, le=_MOST_CHANNELS)
    """Number of channels; 1 by default."""
    type: NumberType | Literal["bit"]
    """How registers hold a number, or `bit`: each channel is one bit, 0 or 1."""
    stride: int | None = Field(default=None, ge=1, le=1000)
    """Distance from one channel to the next, in registers, or in bits for type `bit`; by default there is no gap."""
    bit: int | None = Field(default=None, ge=0, lt=REGISTER_BITS)
    """For type `bit` in registers: the first channel's bit, 0 is the lowest. Channels go on in the next register."""
    unit: Unit = ""
    """Unit of the block's channels; by default the profile's."""

    @model_validator(mode="after")
    def _located(self) -> Self:
        if self.address is None and not self.addresses:
            raise wrong(Text("modbus_no_place"), "address")
        for field in ("address", "count", "stride"):
            if self.addresses and (value := getattr(self, field)) is not None:
                raise wrong(Text("modbus_said_twice", value=value), "channels" if field == "count" else field)
        return self

    @model_validator(mode="after")
    def _readable(self) -> Self:
        in_registers = self.function in REGISTER_FUNCTIONS
        if not in_registers and self.type != "bit":
            raise wrong(Text("modbus_type_of_registers", type=self.type, function=self.function), "type")
        if in_registers and self.type == "bit" and self.bit is None:
            raise wrong(Text("modbus_which_bit"), "bit")
        if self.bit is not None and not (in_registers and self.type == "bit"):
            raise wrong(Text("modbus_bit_alone", bit=self.bit), "bit")
        if self.stride is not None and self.stride < self.width:
            raise wrong(Text("modbus_stride", stride=self.stride, least=self.width, type=self.type), "stride")
        check_shift(self.shift, self.type)
        self.check()
        return self

    def check(self) -> None:
        """For validators: raises an error for tables that do not fit the values."""
        if self.scaled_by == "type_code" and self.type_codes is None:
            raise wrong(Text("modbus_no_type_code"), "type_code")
        for number, sentinel in enumerate(self.sentinels):
            if self._nearest(sentinel.raw) is None:
                what = Text("modbus_sentinel", raw=sentinel.raw, type=self.type)
                if self.shift:
                    what = Text("modbus_sentinel_shifted", raw=sentinel.raw, type=self.type, shift=self.shift)
                raise wrong(what, "sentinel", number, "raw")
        if self.status is not None:
            self.status.check_for(self.channels)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.addresses) or self.count or 1

    @property
    def width(self) -> int:
        """How many registers, or bits, one channel takes."""
        return 1 if self.type == "bit" else registers_of(self.type)

    def place(self, index: int, offset: int) -> AddressRange:
        """Where the value of the block's channel `index` is; offset: added to every address."""
        if self.addresses:
            return self.function, self.addresses[index] + offset, self.width
        distance = index * (self.width if self.stride is None else self.stride)
        if self.bit is not None:
            distance = (self.bit + distance) // REGISTER_BITS
        return self.function, (self.address or 0) + offset + distance, self.width

    def raw(self, index: int, words: Sequence[int]) -> int | float:
        """The number of the channel `index` in the words at its place."""
        if self.bit is None:
            if self._format is None:
                return words[0]
            number = self._format.decode(words)
            return int(number) >> self.shift if self.shift else number
        distance = 0 if self.addresses else index * (self.stride or 1)
        register = int(NumberFormat("uint16", self.byte_order).decode(words))
        return register >> (self.bit + distance) % REGISTER_BITS & 1

    @cached_property
    def sentinel_faults(self) -> Mapping[float, Fault]:
        """What each sentinel means, by the number that replaces the value; of two equal ones the first counts."""
        raws = ((self._nearest(sentinel.raw), sentinel.fault) for sentinel in reversed(self.sentinels))
        return {raw: fault for raw, fault in raws if raw is not None}

    @cached_property
    def _format(self) -> NumberFormat | None:
        """None: of a bit."""
        return None if self.type == "bit" else NumberFormat(self.type, self.byte_order, self.word_order)

    def _nearest(self, number: float) -> int | float | None:
        if self._format is not None:
            if not self.shift:
                return self._format.nearest(number)
            sent = self._format.nearest(number * 2**self.shift) if number.is_integer() else None
            return None if sent is None else int(sent) >> self.shift
        return int(number) if number in (0, 1) else None


class Setting(Section):
    """A bit or register that must hold one number; otherwise the device's values mean something else.

    Checked at every connect.
    """

    function: int = Field(ge=1, le=4)
    """Function code."""
    address: Address
    """Address of the bit or register."""
    equals: int = Field(ge=0, le=65535)
    """The number it must hold."""
    name: str
    """Its name in messages."""
    hint: str
    """What to do if it differs."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.function in BIT_FUNCTIONS and self.equals > 1:
            raise wrong(Text("modbus_equals", equals=self.equals, function=self.function), "equals")
        return self


class WholeBlock(Section):
    """Addresses that the device returns only together, as one request."""

    function: int = Field(ge=1, le=4)
    """Function code."""
    address: Address
    """First address."""
    count: int = Field(ge=1, le=_MOST_BITS)
    """How many registers or bits."""


def _one_table(value: object) -> object:
    if isinstance(value, list):
        raise wrong(Text("modbus_one_value"))
    return value


class ModbusProfile(DeviceProfile, Judged):
    """A Modbus device: `[value]` if its channels are all alike, otherwise a `[[block]]` for each kind."""

    protocol: Literal["modbus"]
    """`modbus`."""
    unit: Unit = ""
    """Unit of every channel whose block does not state another."""
    buses: tuple[Literal["modbus_rtu", "modbus_tcp"], ...]
    """Kinds of bus that the device can be on."""
    count: int | None = Field(default=None, alias="channels", ge=1, le=_MOST_CHANNELS)
    """Number of inputs, with `[value]`."""
    max_registers: int = Field(default=125, ge=1, le=125)
    """The most registers that the device returns in one answer."""
    max_gap: int = Field(default=8, ge=0, le=125)
    """The most unused addresses to read in order to save a request; 0 for a device that refuses them."""
    values: Annotated[Values | None, BeforeValidator(_one_table)] = Field(default=None, alias="value")
    own_blocks: tuple[ChannelBlock, ...] = Field(default=(), alias="block")
    settings: tuple[Setting, ...] = Field(default=(), alias="setting")
    wholes: tuple[WholeBlock, ...] = Field(default=(), alias="whole")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.values is None and not self.own_blocks:
            raise wrong(Text("modbus_no_value"), "value")
        if self.values is not None and self.own_blocks:
            raise wrong(Text("modbus_value_and_block"), "value")
        if self.values is not None and self.count is None:
            raise wrong(Text("missing_no_default"), "channels")
        for field in ("count", *Judged.model_fields):
            if self.own_blocks and field in self.model_fields_set:
                key = type(self).model_fields[field].alias or field
                raise wrong(Text("modbus_of_block"), key)
        for number, block in enumerate(self.own_blocks):
            if not (self.unit or block.unit):
                raise wrong(Text("modbus_no_unit"), "block", number, "unit")
        if self.values is not None and not self.unit:
            raise wrong(Text("missing_no_default"), "unit")
        return self

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if self.values is not None:
            self.blocks[0].check()
        for block in self.blocks:
            if block.width > self.max_registers:
                what = Text("modbus_too_wide", most=self.max_registers, type=block.type, width=block.width)
                raise wrong(what, "max_registers")
        for number, whole in enumerate(self.wholes):
            if whole.function in REGISTER_FUNCTIONS and whole.count > self.max_registers:
                raise wrong(
                    Text("modbus_whole_long", count=whole.count, most=self.max_registers), "whole", number, "count"
                )
        return self

    @cached_property
    def blocks(self) -> tuple[ChannelBlock, ...]:
        """The blocks, of which `[value]` is the short form."""
        if self.values is None:
            return self.own_blocks
        tables = {name: getattr(self, name) for name in Judged.model_fields}
        return (ChannelBlock.model_construct(count=self.count, unit=self.unit, **dict(self.values), **tables),)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return sum(block.channels for block in self.blocks)

    def channel(self, number: int) -> tuple[ChannelBlock, int]:
        """The block of this channel, and its place among the block's channels. Raises IndexError."""
        for block in self.blocks:
            if number < block.channels:
                return block, number
            number -= block.channels
        raise IndexError(f"{self.name} has {self.channels} channels")
