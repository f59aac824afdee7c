"""Kinds of frames that a device reads from a CAN bus."""

from dataclasses import dataclass

FrameId = tuple[int, bool]
"""Identifier, and whether it is a 29-bit one."""


@dataclass(frozen=True, slots=True)
class Page:
    """One of several contents that frames of one identifier have in turn, told by some of their bits."""

    mask: int
    """The bits, in the data as a little-endian number."""
    values: frozenset[int]
    """What may stand in them."""


@dataclass(frozen=True, slots=True)
class WantedFrame:
    """A kind of frame whose latest is kept."""

    identifier: int
    extended: bool = False
    pages: tuple[Page, ...] = ()
    """All of these must fit; none: any content."""

    def fits(self, data: bytes) -> bool:
        """Whether a frame of this identifier is of this kind."""
        number = int.from_bytes(data, "little")
        return all(page.mask.bit_length() <= 8 * len(data) and number & page.mask in page.values for page in self.pages)
