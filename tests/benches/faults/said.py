"""Value sources that return a different value each time and remember when they returned it."""

from collections import deque
from collections.abc import Sequence
from time import monotonic

KEPT = 4000
"""Values that are remembered: more than any device says while one fault is played."""


class Said:
    """Rises from `low` to `high` in steps, one per call, and begins again; all inputs show the same value.

    inputs: how many
    """

    def __init__(self, low: float, high: float, step: float, inputs: int) -> None:
        self._low, self._step, self._inputs = low, step, inputs
        self._steps = round((high - low) / step)
        self._count = 0
        self._said: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self.steady = False
        """From now on it returns the same value, and remembers nothing."""

    def __call__(self) -> Sequence[float]:
        if not self.steady:
            self._count += 1
        value = self._low + self._step * (self._count % self._steps)
        if not self.steady:
            self._said.append((monotonic(), value))
        return [value] * self._inputs

    def between(self, begin_s: float, end_s: float) -> list[float]:
        """What it said after the first monotonic time and not after the second, oldest first."""
        return [value for at, value in tuple(self._said) if begin_s < at <= end_s]


def temperatures(inputs: int, high: float = 80.0) -> tuple[Said, Said]:
    """Sources of two devices, degC, that never return the same number, in steps of a tenth of a degree."""
    return Said(15.0, high, 0.5, inputs), Said(15.25, high, 0.5, inputs)


def distances(inputs: int) -> tuple[Said, Said]:
    """The same, in µm."""
    return Said(100.0, 400.0, 1.0, inputs), Said(100.5, 400.0, 1.0, inputs)
