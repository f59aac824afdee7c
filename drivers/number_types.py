"""Numbers that a device sends: as bytes, by the names of types that profiles use, and as text."""

import re
import struct
from collections.abc import Mapping
from typing import Final, Literal, get_args

from drivers.faults import RawNumber
from drivers.section import wrong
from drivers.text import Text

ByteNumber = Literal[
    "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64"
]
BYTE_FORMATS: Final[Mapping[ByteNumber, str]] = dict(zip(get_args(ByteNumber), "?bhiqBHIQfd", strict=True))
"""As `struct` names them."""
WRITTEN_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""As devices write one; Python's `float` also takes 1_000, other scripts' digits and words."""


def raw_number(kind: ByteNumber, name: str) -> RawNumber:
    """The raw number of this type; name: for messages."""
    bits = 1 if kind == "bool" else 8 * struct.calcsize(BYTE_FORMATS[kind])
    return RawNumber(name, bits, signed=kind.startswith("int"), real=kind.startswith("float"))


def check_shift(shift: int, kind: ByteNumber | Literal["bit"]) -> None:
    """For validators: raises an error for a shift that leaves nothing of the number, or is of a real one."""
    whole = None if kind == "bit" else raw_number(kind, "")
    if shift and (whole is None or whole.real or shift >= whole.bits):
        raise wrong(Text("shift_beyond", shift=shift, type=kind), "shift")
