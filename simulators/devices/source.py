"""The input of an emulated device: a value source and its faults."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

ValueSource = Callable[[], Sequence[float]]
"""Physical values of all channels (degC, or µm) at this moment; called once per request for values."""
Actions = dict[str, Callable[[Any], None]]
"""What a scenario can do to a device: each key, and the function that takes its value."""


class SensorFault(StrEnum):
    """What can be wrong with one sensor."""

    OPEN = "open"
    SHORT = "short"
    OVER = "over"
    UNDER = "under"


@dataclass(slots=True)
class Faults:
    """Faults in force; changed at any time, seen at the next request."""

    by_channel: dict[int, SensorFault] = field(default_factory=dict)
    silent: bool = False
    """The device receives requests, but does not answer."""

    def set(self, channel: int, fault: SensorFault | None) -> None:
        """Break a channel's sensor, or repair it with None."""
        if fault is None:
            self.by_channel.pop(channel, None)
        else:
            self.by_channel[channel] = fault

    def actions(self) -> Actions:
        """The events that every device can have; `fault` takes a channel and its fault."""
        return {"fault": lambda told: self.set(*told), "silent": self._silence}

    def _silence(self, silent: bool) -> None:
        self.silent = silent


def clamp(value: float, low: float, high: float) -> float:
    """The value, or the limit that it exceeds."""
    return min(max(value, low), high)
