"""Waiting times for answers: not much longer than the unit usually takes, so that silence costs little."""

from collections.abc import Hashable
from dataclasses import dataclass
from math import inf, isfinite

_SHORTEST_S = 0.05
"""A USB adapter's latency, a garbage collection or a busy core delays any answer by tens of milliseconds."""
_LEARNT = 4
"""Number of answers after which the usual time is considered known."""
_MEAN = 1 / 8
"""Weight of the newest answer in the mean (RFC 6298)."""
_DEVIATION = 1 / 4
"""Weight of the newest answer in the mean deviation (RFC 6298)."""
_DEVIATIONS = 4
"""How many deviations are added (RFC 6298)."""
_LATENESS = 2
"""How often the lateness of the computer or the line is added."""
_MOST_LATENESS_S = 0.05
"""The most of it that counts."""
_FORGETS = 0.98
"""What remains of it after each answer."""
_SLOW = 1.25
"""How much longer than its mean a request is waited for at least, where a late answer can be had later."""
LONGER = 1.25
"""Factor of the time that late answers take, where they are waited for beyond the longest wait."""
_MOST_LONGER = 10
"""Times the longest wait, no late answer is waited for longer."""
_MOST_LOST = 3
"""So many answers in a row may be lost; longer waits are of no use then."""
_MOST_MISSES = 10
"""More are not counted: the longest wait is reached before."""


@dataclass(slots=True)
class _Usual:
    mean_s: float
    deviation_s: float
    count: int = 1
    misses: int = 0
    """How often the unit has missed since this request was answered."""

    def add(self, took_s: float) -> None:
        self.deviation_s += _DEVIATION * (abs(took_s - self.mean_s) - self.deviation_s)
        self.mean_s += _MEAN * (took_s - self.mean_s)
        self.count += 1


class Patience:
    """Learns how long each request to each unit takes (RFC 6298, as TCP does).

    The longest wait applies until a request has been answered a few times. After its unit misses, a request is waited
    for longer, until it is answered. So a unit that is late once is waited for, and one that falls silent costs its
    neighbours little. When answers of other units were recently late, the computer may be busy, and every unit gets
    more time.

    Parameters
    ----------
    longest_s: upper limit of every wait, s, > 0
    growth: factor of the wait after each miss, where a request is soon repeated and a late answer is as good. Then one
        answer is enough to know the unit, and the first wait is at most half of the longest, unless the unit is always
        slow. Infinite: after one miss the longest wait applies
    """

    def __init__(self, longest_s: float, growth: float = inf) -> None:
        self._longest_s, self._growth = longest_s, growth
        self._learnt = 1 if isfinite(growth) else _LEARNT
        self._usual: dict[int, dict[Hashable, _Usual]] = {}
        self._lateness_s = 0.0

    def wait_s(self, unit: int, request: Hashable, *, loses: bool = False) -> float:
        """How long the answer of this unit to this request may take.

        loses: whether missing answers are usually lost, so that only many in a row show that one is late
        """
        usual = self._usual.get(unit, {}).get(request)
        if usual is None or usual.count < self._learnt:
            return self._longest_s
        more_s = max(_DEVIATIONS * usual.deviation_s, _LATENESS * self._lateness_s)
        wait_s = max(_SHORTEST_S, usual.mean_s + more_s)
        if isfinite(self._growth):
            wait_s = min(wait_s, max(self._longest_s / 2, _SLOW * usual.mean_s))
        misses = max(0, usual.misses - _MOST_LOST) if loses else usual.misses
        return min(self._longest_s, wait_s * self._growth**misses)

    def late_s(self, wanted_s: float) -> float:
        """How long an answer is waited for that always comes late: that long, within what is reasonable."""
        return min(max(self._longest_s, wanted_s), _MOST_LONGER * self._longest_s)

    def usual_s(self) -> dict[int, float]:
        """How long each unit that has answered usually takes for its slowest request, s."""
        return {unit: max(usual.mean_s for usual in list(of.values())) for unit, of in list(self._usual.items())}

    def answered(self, unit: int, request: Hashable, took_s: float) -> None:
        """Record an answer that certainly belongs to this request."""
        requests = self._usual.setdefault(unit, {})
        usual = requests.get(request)
        if usual is None:
            requests[request] = _Usual(took_s, took_s / 2)
        else:
            late_s = min(took_s - usual.mean_s, _MOST_LATENESS_S)
            self._lateness_s = max(late_s, _FORGETS * self._lateness_s)
            usual.add(took_s)
            usual.misses = 0

    def missed(self, unit: int, request: Hashable = None) -> None:
        """Record that a unit did not answer in time.

        request: the only one that is waited for longer; None: all are
        """
        for known, usual in self._usual.get(unit, {}).items():
            if request in (None, known):
                usual.misses = min(usual.misses + 1, _MOST_MISSES)
