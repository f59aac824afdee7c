"""Modbus profiles: where a device's registers are, what they mean, how it reports a broken sensor."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.faults import CodeRule, Fault, code_rule, fault
from drivers.toml_table import Table

Order = Literal["big", "little"]

REGISTER_FUNCTIONS = (3, 4)
BIT_FUNCTIONS = (1, 2)
_REGISTER_BITS = 16

_FORMATS = {"int16": ("h", 1), "uint16": ("H", 1), "int32": ("i", 2), "uint32": ("I", 2), "float32": ("f", 2)}


@dataclass(frozen=True, slots=True)
class Block:
    """One read request: function code 1 to 4, first address (counted from 0), count of registers or bits."""

    function: int
    address: int
    count: int


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """How a number lies in registers."""

    type: str
    byte_order: Order = "big"
    """Order of the two bytes in a register; Modbus says big."""
    word_order: Order = "big"
    """Order of the registers of a 32-bit number; Modbus does not say, vendors differ."""

    @property
    def registers(self) -> int:
        return _FORMATS[self.type][1]

    def decode(self, registers: Sequence[int]) -> int | float:
        """The number in `registers` (as many as `self.registers`, each 0..65535)."""
        words = registers if self.word_order == "big" else tuple(reversed(registers))
        raw = b"".join(word.to_bytes(2, self.byte_order) for word in words)
        number: int | float = struct.unpack(">" + _FORMATS[self.type][0], raw)[0]
        return number

    def nearest(self, number: float) -> int | float | None:
        """What a device sends for this number; None when it cannot be sent: too large, or a fraction of an integer."""
        form = ">" + _FORMATS[self.type][0]
        if self.type != "float32" and not float(number).is_integer():
            return None
        try:
            sent: int | float = struct.unpack(
                form, struct.pack(form, number if self.type == "float32" else int(number))
            )[0]
        except (struct.error, OverflowError):
            return None
        return sent


_SPAN_MARGIN = 0.01


@dataclass(frozen=True, slots=True)
class Span:
    """Linear scaling: raw low and high (numbers) stand for low and high in the profile's unit."""

    raw_low: float
    raw_high: float
    low: float
    high: float

    def apply(self, raw: float) -> float:
        return self.low + (raw - self.raw_low) * (self.high - self.low) / (self.raw_high - self.raw_low)

    def holds(self, value: float) -> bool:
        """Whether an input set to this span can measure the value; modules go a little beyond what they promise."""
        margin = _SPAN_MARGIN * (self.high - self.low)
        return self.low - margin <= value <= self.high + margin


@dataclass(frozen=True, slots=True)
class Values:
    """Where the measured values are. Channel i starts at `address + i * stride`."""

    function: int
    address: int
    stride: int
    format: NumberFormat
    scale: float
    """Value = raw * scale + offset, unless the type code gives the scaling."""
    offset: float
    scaled_by_type_code: bool


@dataclass(frozen=True, slots=True)
class TypeCodes:
    """Registers that say what is connected and how it is scaled; checked whenever the device is connected."""

    function: int
    address: int
    spans: dict[int, Span]
    """Every code that this profile can read, with its scaling."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A bit or register of the device that must hold one number, or its values mean something else.

    Checked whenever the device is connected.
    """

    function: int
    address: int
    equals: int
    name: str
    hint: str
    """What to do when it is otherwise."""


@dataclass(frozen=True, slots=True)
class FaultBits:
    """One bit a channel, from `address` on, set when the device finds its sensor broken."""

    function: int
    address: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class StatusRegister:
    """Registers that tell each sensor's state by number or bits, one for a channel or one for several."""

    function: int
    address: int
    stride: int
    """From one status register to the next."""
    channels_per_register: int
    bit_stride: int
    """By how many bits a channel's status is higher than that of the channel before, in the same register."""
    mask: int
    """The bits that are the first channel's status; others are not looked at."""
    good: frozenset[int]
    rules: tuple[CodeRule, ...]

    def register(self, channel: int) -> int:
        """Address of the register that holds the channel's status."""
        return self.address + channel // self.channels_per_register * self.stride

    def code(self, channel: int, register: int) -> int:
        """The channel's status out of that register, as if the channel were the register's first."""
        return register >> channel % self.channels_per_register * self.bit_stride & self.mask


@dataclass(frozen=True, slots=True)
class Sentinel:
    """A raw number that the device sends instead of a value."""

    raw: float
    fault: Fault


@dataclass(frozen=True, slots=True)
class Plausibility:
    """For devices that report nothing: a value outside, or a sensor changing faster than physics allows, is doubtful.

    Only a guess: an open input may still show a plausible number.
    """

    low: float
    high: float
    suspicious: tuple[float, float] | None
    """Values (low, high) that this device is known to show with an open input."""


@dataclass(frozen=True, slots=True)
class ModbusProfile:
    """A Modbus device with equal channels."""

    name: str
    title: str
    buses: tuple[str, ...]
    channels: int
    unit: str
    confirm: tuple[str, ...]
    """What was not found in a manual: check it on the device."""
    max_registers: int
    """Most registers that the device gives in one answer."""
    max_gap: int
    """Most addresses read for nothing rather than asking twice; 0 for a device that refuses addresses between."""
    values: Values
    settings: tuple[Setting, ...]
    type_codes: TypeCodes | None
    fault_bits: FaultBits | None
    status: StatusRegister | None
    sentinels: tuple[Sentinel, ...]
    plausibility: Plausibility | None


def modbus_profile(name: str, table: Table) -> ModbusProfile:
    """Read a profile of `protocol = "modbus"`. Raises SetupError."""
    values = _values(table.table("value"))
    channels = table.integer("channels", low=1, high=1000)
    profile = ModbusProfile(
        name=name,
        title=table.text("title"),
        buses=table.texts("buses"),
        channels=channels,
        unit=table.text("unit"),
        confirm=table.texts("confirm", ()),
        max_registers=table.integer("max_registers", 125, low=1, high=125),
        max_gap=table.integer("max_gap", 8, low=0, high=125),
        values=values,
        settings=tuple(_setting(entry) for entry in table.tables("setting")),
        type_codes=_type_codes(table.table("type_code")) if table.has("type_code") else None,
        fault_bits=_fault_bits(table.table("fault_bits")) if table.has("fault_bits") else None,
        status=_status(table.table("status"), channels) if table.has("status") else None,
        sentinels=tuple(_sentinel(entry, values.format) for entry in table.tables("sentinel")),
        plausibility=_plausibility(table.table("plausibility")) if table.has("plausibility") else None,
    )
    if profile.values.scaled_by_type_code and profile.type_codes is None:
        raise table.error("type_code", 'value.scaled_by = "type_code" needs this table')
    if (least := values.format.registers) > profile.max_registers:
        raise table.error(
            "max_registers", f"{profile.max_registers}, but a {values.format.type} takes {least} registers"
        )
    for bus in profile.buses:
        if bus not in ("modbus_rtu", "modbus_tcp"):
            raise table.error("buses", f"{bus!r} is none of modbus_rtu, modbus_tcp")
    table.finish()
    return profile


def _function(table: Table, allowed: tuple[int, ...]) -> int:
    function = table.integer("function", low=1, high=4)
    if function not in allowed:
        raise table.error("function", f"{function} does not read {'bits' if allowed == BIT_FUNCTIONS else 'registers'}")
    return function


def _address(table: Table) -> int:
    return table.integer("address", low=0, high=65535)


def _order(table: Table, key: str) -> Order:
    return "little" if table.text(key, "big", choices=("big", "little")) == "little" else "big"


def _values(table: Table) -> Values:
    number = NumberFormat(
        table.text("type", choices=_FORMATS), _order(table, "byte_order"), _order(table, "word_order")
    )
    values = Values(
        function=_function(table, REGISTER_FUNCTIONS),
        address=_address(table),
        stride=table.integer("stride", number.registers, low=number.registers, high=1000),
        format=number,
        scale=table.number("scale", 1.0),
        offset=table.number("offset", 0.0),
        scaled_by_type_code=table.text("scaled_by", "fixed", choices=("fixed", "type_code")) == "type_code",
    )
    if values.scale == 0:
        raise table.error("scale", "0 would make every value equal")
    table.finish()
    return values


def _type_codes(table: Table) -> TypeCodes:
    function, address = _function(table, REGISTER_FUNCTIONS), _address(table)
    raw_low, raw_high = table.number("raw_low", 0.0), table.number("raw_high", 1.0)
    spans: dict[int, Span] = {}
    for entry in table.tables("code"):
        code = entry.integer("code", low=0, high=65535)
        span = Span(
            entry.number("raw_low", raw_low),
            entry.number("raw_high", raw_high),
            entry.number("low"),
            entry.number("high"),
        )
        if span.low >= span.high:
            raise entry.error("low", f"{span.low} is not below high = {span.high}")
        if span.raw_low == span.raw_high:
            raise entry.error("raw_low", f"{span.raw_low} is raw_high, too: every value would be equal")
        entry.finish()
        spans[code] = span
    if not spans:
        raise table.error("code", "at least one type code is needed")
    table.finish()
    return TypeCodes(function, address, spans)


def _setting(table: Table) -> Setting:
    function = table.integer("function", low=1, high=4)
    setting = Setting(
        function=function,
        address=_address(table),
        equals=table.integer("equals", low=0, high=1 if function in BIT_FUNCTIONS else 65535),
        name=table.text("name"),
        hint=table.text("hint"),
    )
    table.finish()
    return setting


def _fault_bits(table: Table) -> FaultBits:
    bits = FaultBits(_function(table, BIT_FUNCTIONS), _address(table), fault(table))
    table.finish()
    return bits


def _status(table: Table, channels: int) -> StatusRegister:
    function, address = _function(table, REGISTER_FUNCTIONS), _address(table)
    stride = table.integer("stride", 1, low=1, high=1000)
    together = table.integer("channels_per_register", 1, low=1, high=_REGISTER_BITS)
    bit_stride = table.integer("bit_stride", low=1, high=_REGISTER_BITS - 1) if together > 1 else 0
    mask = table.integer("mask", (1 << bit_stride) - 1 if together > 1 else 0xFFFF, low=1, high=0xFFFF)
    status = StatusRegister(
        function, address, stride, together, bit_stride, mask,
        good=frozenset(table.integers("good", (0,))),
        rules=tuple(code_rule(entry, mask) for entry in table.tables("rule")),
    )  # fmt: skip
    last = min(together, channels) - 1
    if (highest := mask.bit_length() - 1 + last * bit_stride) >= _REGISTER_BITS:
        raise table.error(
            "bit_stride", f"{bit_stride} puts the status of channel {last} at bit {highest}; a register ends at 15"
        )
    if wrong := [code for code in status.good if code & ~mask]:
        raise table.error("good", f"{wrong[0]} never comes; only bits within mask = 0x{mask:X} are looked at")
    table.finish()
    return status


def _sentinel(table: Table, form: NumberFormat) -> Sentinel:
    number = table.number("raw")
    raw = form.nearest(number)
    if raw is None:
        raise table.error("raw", f"{number:g} never comes as {form.type}")
    sentinel = Sentinel(raw, fault(table))
    table.finish()
    return sentinel


def _plausibility(table: Table) -> Plausibility:
    low, high = table.number("low"), table.number("high")
    if low >= high:
        raise table.error("low", f"{low} is not below high = {high}")
    suspicious = None
    if table.has("open_input_low") or table.has("open_input_high"):
        suspicious = (table.number("open_input_low"), table.number("open_input_high"))
        if suspicious[0] > suspicious[1]:
            raise table.error("open_input_low", f"{suspicious[0]} is above open_input_high = {suspicious[1]}")
    table.finish()
    return Plausibility(low, high, suspicious)
