"""Polling settings of any bus and any control."""

from collections.abc import Iterator
from typing import ClassVar, Final

from pydantic import Field

from drivers.section import Positive, Section
from gateway.config.fields import Name

PERIOD_S: Final = 1.0
READ_LIMIT_S: Final = 10.0
RETRY_MAX_PERIODS: Final = 60
"""How a bus is polled of which nothing is stated."""


class Polled(Section):
    """How the gateway polls a bus."""

    name: Name
    """Name by which devices and messages refer to the bus."""
    period_s: Positive = PERIOD_S
    """Every device of the bus is read once in each period."""
    read_limit_s: Positive = READ_LIMIT_S
    """How long one whole read of a device may take; after that the bus is closed and opened again."""
    retry_max_periods: int = Field(default=RETRY_MAX_PERIODS, ge=1, le=3600)
    """A silent device, or a bus that does not open, is tried again after 1, 2, 4 ... periods, up to this number."""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. May read files."""
        yield from ()


class PolledControl(Section):
    """How the gateway polls a control of any kind, and what that kind can do."""

    period_s: Positive = 1.0
    """Interval at which positions and states are read and compensation, if any, is written."""

    largest_is: ClassVar[str] = "the driver's largest_um"
    """What bounds the offsets, in words."""
    only_read: ClassVar[bool] = False
    """Whether it can only be read: `check` then accepts neither armed probing nor `mode = "compensate"`."""
