"""Places of numbers in a CANopen node: entries of its object dictionary."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CanObject:
    """One entry of a node's object dictionary."""

    index: int
    subindex: int

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.subindex:02X}"
