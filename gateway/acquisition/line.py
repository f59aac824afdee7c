"""One bus with its drivers, and how they are read."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.base import Bus, Driver
from gateway.config import Limits


@dataclass(frozen=True, slots=True)
class Line:
    """One bus with the drivers of its devices, and the policy for both."""

    bus: Bus
    drivers: tuple[Driver, ...]
    period_s: float = 1.0
    retry_max_periods: int = 60
    read_limit_s: float = 10.0
    """Real seconds that one read may take before the bus is closed and opened again."""
    plausible: Mapping[str, Limits] = field(default_factory=dict)
    """Stated limits, by channel."""
    phase_s: float = 0.0
    """Delay of the polls after the first, relative to a line without a delay."""
