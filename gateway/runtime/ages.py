"""Ages of events across a restart: by the monotonic clock, or by a wall clock known to be right.

A grid index is a time within a record. What links the record to the present is its last moment. While the computer
stays on, its monotonic clock continues. Otherwise only the wall clock can tell, if it was synchronised then and is now;
if not, the age is not known, and what rests on it is taken for older than any limit.
"""

import math
from collections.abc import Sequence

from gateway.model.step_time import StepTime
from gateway.runtime.clocks import ServiceClock

_SET_S = 1.0
"""Between two looks quartz and a slewed clock move less against the monotonic clock; somebody who sets it, more."""


class Ages:
    """Times of earlier grid indices on this run's monotonic clock.

    Parameters
    ----------
    clock: this run's
    step_s: grid step
    last: the last moment of the record; None: there is no record
    pauses: indices of first steps after a pause whose length is not covered by the indices
    """

    def __init__(self, clock: ServiceClock, step_s: float, last: StepTime | None, pauses: Sequence[int] = ()) -> None:
        self._clock, self._step_s, self._last, self._pauses = clock, step_s, last, tuple(pauses)
        self._same_start = last is not None and last.origin == clock.origin()
        self._known = self._same_start and last is not None and last.known
        self._ahead_s = self._ahead_of_monotonic_s()

    @property
    def known(self) -> bool:
        """Whether the wall clock has been synchronised since the computer started; it stays so, as quartz is enough,
        until it is set."""
        before_s, self._ahead_s = self._ahead_s, self._ahead_of_monotonic_s()
        unmoved = abs(self._ahead_s - before_s) <= _SET_S
        self._known = (self._known and unmoved) or self._clock.synchronised()
        return self._known

    @property
    def pause_s(self) -> float:
        """Seconds since the last moment of the record; inf: not known."""
        if self._last is None:
            return 0.0
        if self._same_start:
            return max(0.0, self._clock.monotonic() - self._last.monotonic_s)
        if not (self.known and self._last.known):
            return math.inf
        passed_s = self._clock.utc().timestamp() + self._last.lead_s - self._last.k * self._step_s
        return passed_s if passed_s >= 0 else math.inf

    @property
    def lead_s(self) -> float:
        """How far the numbering goes on ahead of UTC: as at the last moment, or by whole steps more where a clock that
        was ahead has been set back since; else the pause would be as if it had not been."""
        if self._last is None:
            return 0.0
        if self._same_start and self.known:
            numbered_s = self._last.k * self._step_s
            ahead_s = numbered_s - self._clock.utc().timestamp() + self.pause_s
            if ahead_s - self._last.lead_s > self._step_s / 2:
                return math.ceil(ahead_s / self._step_s) * self._step_s
        return self._last.lead_s

    def _ahead_of_monotonic_s(self) -> float:
        return self._clock.utc().timestamp() - self._clock.monotonic()

    def monotonic_of(self, k: int | None) -> float:
        """When grid index k was, on this run's monotonic clock; -inf: long ago, never, or not known."""
        if k is None or self._last is None or any(k < pause for pause in self._pauses):
            return -math.inf
        return self._clock.monotonic() - (self._last.k - k) * self._step_s - self.pause_s
