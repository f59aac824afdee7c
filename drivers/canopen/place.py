"""Places of numbers in a CANopen node: entries of its object dictionary."""

from dataclasses import dataclass

from drivers.text import Text, shown


@dataclass(frozen=True, slots=True)
class CanObject:
    """One entry of a node's object dictionary."""

    index: int
    subindex: int

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
