"""Places of numbers in a CANopen node: entries of its object dictionary, and what the answers to them look like."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drivers.text import Text, shown

KIND: Final = 0xE0
"""Bits of the first byte of an SDO answer that say what it is: one of the next three."""
SEGMENT: Final = 0x00
BEGINS: Final = 0x40
ABORT: Final = 0x80
TOGGLE: Final = 0x10
"""Bit of the first byte of an SDO frame that changes from segment to segment."""


@dataclass(frozen=True, slots=True)
class CanObject:
    """One entry of a node's object dictionary."""

    index: int
    subindex: int

    @property
    def address(self) -> bytes:
        """As it is in an SDO frame."""
        return self.index.to_bytes(2, "little") + bytes((self.subindex,))

    @property
    def request(self) -> bytes:
        """The SDO frame that asks for it."""
        return bytes((BEGINS,)) + self.address + bytes(4)

    def is_answered_by(self, answer: bytes) -> bool:
        """Whether an SDO answer may be to this; some nodes state no object when they abort."""
        is_abort = answer[0] & KIND == ABORT and answer[1:4] == bytes(3)
        return is_abort or (answer[0] & KIND != SEGMENT and answer[1:4] == self.address)

    def is_like(self, other: "CanObject") -> bool:
        """Whether the answers to both look the same, or one would end the other's transfer."""
        return isinstance(other, Segment) or self == other

    def another(self, due: "Sequence[CanObject]", _: object) -> "CanObject":
        """An object that is never a value, and none that is due if possible."""
        return min((one for one in _NEVER_VALUES if one != self), key=lambda one: due.count(one))

    @classmethod
    def of(cls, text: str) -> "CanObject":
        """From `2100:01`, both hexadecimal; without a sub-index: 0. Raises ValueError."""
        index, _, subindex = text.partition(":")
        try:
            found = cls(int(index, 16), int(subindex or "0", 16))
        except ValueError:
            raise ValueError(Text("object_form", value=shown(text))) from None
        if not (0x1000 <= found.index <= 0xFFFF and found.subindex <= 0xFF):
            raise ValueError(Text("object_beyond", value=shown(text)))
        return found

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.subindex:02X}"


@dataclass(frozen=True, slots=True)
class Segment(CanObject):
    """The next part of a number of more than four bytes."""

    toggle: int

    @property
    def request(self) -> bytes:
        return bytes((0x60 | self.toggle,)) + bytes(7)

    def is_answered_by(self, answer: bytes) -> bool:
        if answer[0] & KIND == ABORT:
            return answer[1:4] in (self.address, bytes(3))
        return answer[0] & (KIND | TOGGLE) == SEGMENT | self.toggle

    def is_like(self, other: CanObject) -> bool:  # noqa: ARG002
        return True


_NEVER_VALUES = CanObject(0x1000, 0), CanObject(0x1001, 0), *(CanObject(0x1018, subindex) for subindex in range(16))
"""Objects that no channel reads. Every node has the first four (CiA 301), and refuses by name what it has not. Many,
because a node that was one answer behind has left many requests unanswered, and its next answer must be to one that
has not been asked for."""
