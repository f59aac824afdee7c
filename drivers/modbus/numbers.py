"""Number formats in the registers of a Modbus device, and its read requests."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers.readings import total
from drivers.requests import REFUSED
from drivers.text import NOTHING, Text

Order = Literal["big", "little"]
NumberType = Literal["int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]

AddressRange = tuple[int, int, int]
"""Function, address, width."""

REGISTER_FUNCTIONS = (3, 4)
BIT_FUNCTIONS = (1, 2)
REGISTER_BITS = 16
_FORMATS: Mapping[object, tuple[str, int]] = {
    "int16": ("h", 1),
    "uint16": ("H", 1),
    "int32": ("i", 2),
    "uint32": ("I", 2),
    "int64": ("q", 4),
    "uint64": ("Q", 4),
    "float32": ("f", 2),
    "float64": ("d", 4),
}
_REALS = ("float32", "float64")
_IN_MANUALS = {4: ((30001, 39999), (300001, 365536)), 3: ((40001, 49999), (400001, 465536))}
"""How manuals number the registers that each function reads, in five and six digits: the first and the last one."""


def registers_of(kind: object) -> int:
    """How many registers a number of this type occupies; 1 for an unknown type."""
    return _FORMATS.get(kind, ("", 1))[1]


def as_in_manuals(address: int) -> Text:
    """What to write instead of an address such as 30101; empty if it is not one of those."""
    for function, ranges in _IN_MANUALS.items():
        for first, last in ranges:
            if first <= address <= last:
                meant = Text("modbus_in_manuals", address=address, function=function, meant=address - first)
                return Text("modbus_counts_from_0", meant=meant)
    return NOTHING


class Block(NamedTuple):
    """One read request: function code 1 to 4, first address (counted from 0), count of registers or bits.

    A tuple, because each request is looked up in several tables.
    """

    function: int
    address: int
    count: int  # type: ignore[assignment]  # instead of tuple's method, which nobody needs

    @property
    def data_bytes(self) -> int:
        """How many bytes of data answer it."""
        return (self.count + 7) // 8 if self.function in BIT_FUNCTIONS else 2 * self.count

    def is_answered_by(self, message: bytes) -> bool:
        """Whether a message (function code and data) has the form of its answer, or of its refusal."""
        if message[0] & REFUSED:
            return message[0] & ~REFUSED == self.function
        return message[0] == self.function and message[1] == self.data_bytes

    def is_like(self, other: "Block") -> bool:
        """Whether the answers of one unit to both look the same: they carry neither address nor number."""
        return self.function == other.function and self.data_bytes == other.data_bytes

    def another(self, due: Sequence["Block"], refused: Sequence["Block"]) -> "Block":
        """A request at the same address whose answer has another form, and none that is due if possible.

        refused: those of them that may have been refused. If one has the same function, this has another, whose refusal
        differs, too
        """
        function = self.function
        if any(one.function == function for one in refused):
            functions = sorted({*REGISTER_FUNCTIONS, *BIT_FUNCTIONS} - {function}, reverse=True)
            function = min(functions, key=lambda f: sum(one.function == f for one in due))
        counts = range(1, 48, 8) if function in BIT_FUNCTIONS else range(1, 7)
        others = [Block(function, self.address, count) for count in counts]
        return min((o for o in others if not o.is_like(self)), key=lambda other: sum(map(other.is_like, due)))


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """How registers hold a number."""

    type: NumberType
    byte_order: Order = "big"
    """Order of the two bytes in a register; Modbus specifies big."""
    word_order: Order = "big"
    """Order of the registers of a 32-bit or 64-bit number; Modbus does not specify it, and vendors differ."""

    @property
    def registers(self) -> int:
        return _FORMATS[self.type][1]

    def decode(self, registers: Sequence[int]) -> int | float:
        """The number in `registers` (as many as `self.registers`, each 0..65535)."""
        words = registers if self.word_order == "big" else tuple(reversed(registers))
        form, count = _FORMATS[self.type]
        raw = struct.pack(f"{'>' if self.byte_order == 'big' else '<'}{count}H", *words)
        number: int | float = struct.unpack(">" + form, raw)[0]
        return number

    def nearest(self, number: float) -> int | float | None:
        """What a device sends for this number; None if it cannot: too large, or a fraction of an integer."""
        form = ">" + _FORMATS[self.type][0]
        if self.type not in _REALS and not float(number).is_integer():
            return None
        try:
            sent: int | float = struct.unpack(form, struct.pack(form, number if self.type in _REALS else int(number)))[
                0
            ]
        except (struct.error, OverflowError):
            return None
        return sent


_SPAN_MARGIN = 0.01


@dataclass(frozen=True, slots=True)
class Span:
    """Linear scaling: raw low and high (numbers) correspond to low and high in the profile's unit."""

    raw_low: float
    raw_high: float
    low: float
    high: float

    def apply(self, raw: float) -> float:
        return total(self.low, (raw - self.raw_low) * (self.high - self.low) / (self.raw_high - self.raw_low))

    def holds(self, value: float) -> bool:
        """Whether an input set to this span can measure the value; modules go slightly beyond their nominal range."""
        margin = _SPAN_MARGIN * (self.high - self.low)
        return self.low - margin <= value <= self.high + margin
