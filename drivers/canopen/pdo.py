"""Transmit PDOs: which frames carry which objects of a node (CiA 301, objects 1800.. and 1A00..)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.canopen.place import CanObject

COMMUNICATION = 0x1800
MAPPING = 0x1A00
TPDOS = 4
"""Number of TPDOs that are read; CiA 404 uses the first four."""
EVERY_SYNC = 1
"""Transmission type: sent after each SYNC."""
ON_EVENTS = (254, 255)
"""Transmission types: sent on an event, and whenever the event timer of sub-index 5 expires."""

_INVALID = 1 << 31
_LONGEST_FRAME = 8


@dataclass(frozen=True, slots=True)
class PdoMap:
    """One TPDO: its identifier, and the position of each mapped object (first byte, size)."""

    identifier: int
    places: Mapping[CanObject, tuple[int, int]]
    event_s: float = 0.0
    """Event timer, s; 0 if it is not sent on a timer."""

    def decode(self, data: bytes) -> dict[CanObject, bytes]:
        """The objects in one frame, each as little-endian bytes; those that a short frame lacks are missing."""
        return {
            entry: data[start : start + size]
            for entry, (start, size) in self.places.items()
            if len(data) >= start + size
        }


def pdo_map(cob_id: int, mapped: Sequence[int]) -> PdoMap | None:
    """From objects 18xx:01 and 1Axx:01.. (index, sub-index, bits); None when the TPDO is disabled or empty.

    Entries that are no whole bytes, or beyond what a frame holds, are left out.
    """
    if cob_id & _INVALID or not mapped:
        return None
    places: dict[CanObject, tuple[int, int]] = {}
    start = 0  # bits
    for entry in mapped:
        index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if bits and not (bits % 8 or start % 8) and start + bits <= 8 * _LONGEST_FRAME:
            places[CanObject(index, subindex)] = start // 8, bits // 8
        start += bits
    return PdoMap(cob_id & 0x7FF, places)
