"""How any bus is polled."""

from pydantic import Field

from drivers.section import Positive, Section
from gateway.config.fields import Name


class Polled(Section):
    """How the gateway polls a bus."""

    name: Name
    """Name by which devices and messages refer to the bus."""
    period_s: Positive = 1.0
    """Every device of the bus is read once in each period."""
    read_limit_s: Positive = 10.0
    """How long one whole read of a device may take; after that the bus is closed and opened again."""
    retry_max_periods: int = Field(default=60, ge=1, le=3600)
    """A silent device, or a bus that does not open, is tried again after 1, 2, 4 ... periods, up to this number."""
