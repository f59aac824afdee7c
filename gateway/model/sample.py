"""A reading as it is stored and published, with a sequence number that distinguishes it from all others."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from drivers.base import Reading


@dataclass(frozen=True, slots=True)
class Sample(Reading):
    """A reading that the acquisition took."""

    sequence: int = field(kw_only=True)
    """The same for all channels of one read; no two reads of one run of the gateway have the same number."""


def samples(readings: Iterable[Reading], sequence: int) -> list[Sample]:
    """The readings of one read, with its number."""
    return [
        Sample(r.channel, r.value, r.unit, r.quality, r.source_time, r.monotonic_s, r.detail, sequence=sequence)
        for r in readings
    ]
