"""Scaling from a raw value to a distance, and the recognition of a measurement that is not renewed."""

from collections.abc import Hashable

from drivers.base import Quality
from drivers.faults import Fault
from drivers.micro_epsilon.profile import StreamValue
from drivers.micro_epsilon.settings import DisplacementOptions
from drivers.readings import total
from drivers.text import Text

_LAST_COUNT = 0xFFFFFF
"""A converter of 24 bits stands at 0 or here whenever its probe is out of range or unplugged (capaNCDT 6200, 6.2)."""


def distance_um(raw: float, value: StreamValue, options: DisplacementOptions) -> float | Fault:
    """From the zero of the options; a fault outside the measuring range."""
    fraction = raw / value.full_scale
    if not 0.0 <= fraction <= 1.0:
        return Fault(Quality.OUT_OF_RANGE, Text("me_beyond_range", fraction=fraction))
    return total(fraction * options.range_um, -options.zero_um)


def counted_um(count: int, value: StreamValue, options: DisplacementOptions) -> float | Fault:
    """The same of a converter's count: its first and last one do not tell where the target is."""
    if count in (0, _LAST_COUNT):
        return Fault(Quality.OUT_OF_RANGE, Text("me_before_range" if count == 0 else "me_after_range", count=count))
    return distance_um(count, value, options)


class Renewal:
    """Whether a device that counts its measurements still measures."""

    def __init__(self) -> None:
        self._last: tuple[int, Hashable] | None = None

    def fault(self, counter: int, values: Hashable) -> Fault | None:
        """The fault of a measurement that is the one of the last read, counter and values alike."""
        same, self._last = self._last == (counter, values), (counter, values)
        if not same:
            return None
        what = Text("me_stands_still", counter=counter)
        return Fault(Quality.STALE, what)
