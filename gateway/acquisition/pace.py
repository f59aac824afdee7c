"""Detects a bus whose devices together take longer than its period. A small object without clock or sleep."""

from collections import deque
from collections.abc import Mapping

from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_POLLS = 10
_TOO_MANY = 2
"""Slow polls among the last ten: a single one may be due to a busy computer or to a device that is checked again."""


class Pace:
    """Counts the periods missed because answers took too long, and finds the slowest device.

    Time lost to silent devices does not count: those are reported elsewhere.

    Parameters
    ----------
    period_s: s, > 0
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._missed: deque[int] = deque(maxlen=_POLLS)
        self._slow = False
        self._total_s = self._longest_s = 0.0
        self._longest = ""

    @property
    def slow(self) -> bool:
        """From the second slow poll of the last ten until none of the last ten is."""
        return self._slow

    def polled(self, answered_s: Mapping[str, float], missed: int) -> None:
        """Record a poll: how long each device that answered took, s, and how many periods passed meanwhile."""
        total_s = sum(answered_s.values())
        is_slow = missed > 0 and total_s > self._period_s
        self._missed.append(missed if is_slow else 0)
        if is_slow:
            self._total_s = total_s
            self._longest = max(answered_s, key=lambda name: answered_s[name])
            self._longest_s = answered_s[self._longest]
        slow_polls = sum(missed > 0 for missed in self._missed)
        self._slow = slow_polls > 0 if self._slow else slow_polls >= _TOO_MANY

    def text(self, bus: str) -> Text:
        """The problem of the bus with this name."""
        missed = sum(self._missed)
        return Text(
            NoticeCode.BUS_SLOW,
            bus=bus,
            missed=missed,
            periods=missed + len(self._missed),
            period_s=self._period_s,
            total_s=self._total_s,
            longest=self._longest,
            longest_s=self._longest_s,
        )
