"""One bus with its drivers, and how they are read."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.base import Bus, Driver
from gateway.config.polled import PERIOD_S, READ_LIMIT_S, RETRY_MAX_PERIODS
from gateway.config.sections import Limits


@dataclass(frozen=True, slots=True)
class Line:
    """One bus with the drivers of its devices, and the policy for both."""

    bus: Bus
    drivers: tuple[Driver, ...]
    period_s: float = PERIOD_S
    retry_max_periods: int = RETRY_MAX_PERIODS
    read_limit_s: float = READ_LIMIT_S
    """Real seconds that one read may take before the bus is closed and opened again."""
    plausible: Mapping[str, Limits] = field(default_factory=dict)
    """Stated limits, by channel."""
    phase_s: float = 0.0
    """Delay of the polls after the first, relative to a line without a delay."""
