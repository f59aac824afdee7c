"""Scaling from a raw value to a distance."""

from drivers.base import Quality
from drivers.faults import Fault
from drivers.micro_epsilon.profile import StreamValue
from drivers.micro_epsilon.settings import DisplacementOptions
from drivers.readings import total


def distance_um(raw: float, value: StreamValue, options: DisplacementOptions) -> float | Fault:
    """From the zero of the options; a fault outside the measuring range."""
    fraction = raw / value.full_scale
    if not 0.0 <= fraction <= 1.0:
        return Fault(Quality.OUT_OF_RANGE, f"{fraction:.3g} of the measuring range; 0 to 1 can be measured")
    return total(fraction * options.range_um, -options.zero_um)
