"""Types of numbers that a device sends as bytes, by the names that profiles use."""

from collections.abc import Mapping
from typing import Final, Literal, get_args

from drivers.faults import RawNumber

ByteNumber = Literal[
    "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64"
]
BYTE_FORMATS: Final[Mapping[ByteNumber, str]] = dict(zip(get_args(ByteNumber), "?bhiqBHIQfd", strict=True))
"""As `struct` names them."""


def raw_number(kind: ByteNumber, name: str) -> RawNumber:
    """The raw number of this type; name: for messages."""
    bits = 8 if kind == "bool" else int(kind.lstrip("uintfloa"))
    return RawNumber(name, bits, signed=kind.startswith("int"), real=kind.startswith("float"))
