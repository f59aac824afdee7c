"""How long to wait for an answer: not much longer than the unit usually takes, so that silence costs little."""

from collections.abc import Hashable
from dataclasses import dataclass

_SHORTEST_S = 0.05
"""A USB adapter's latency, a garbage collection or a busy core delays any answer by tens of milliseconds."""
_LEARNT = 4
"""Number of answers after which the usual time is considered known."""
_MEAN, _DEVIATION, _DEVIATIONS = 1 / 8, 1 / 4, 4
"""RFC 6298: weight of the newest answer in the mean and in the mean deviation, and how many deviations are added."""
_LATENESS, _MOST_LATENESS_S, _FORGETS = 2, 0.05, 0.98
"""How often the lateness of the computer or the line is added, the most of it that counts, and what remains of it after
each answer."""


@dataclass(slots=True)
class _Usual:
    mean_s: float
    deviation_s: float
    count: int = 1
    missed: bool = False

    def add(self, took_s: float) -> None:
        self.deviation_s += _DEVIATION * (abs(took_s - self.mean_s) - self.deviation_s)
        self.mean_s += _MEAN * (took_s - self.mean_s)
        self.count += 1


class Patience:
    """Learns how long each request to each unit takes (RFC 6298, as TCP does).

    The longest wait applies until a request has been answered a few times, and again after its unit misses until that
    unit answers. So a unit that is late once is waited for, and one that falls silent costs its neighbours little.
    When answers of other units were recently late, the computer may be busy, and every unit gets more time.

    Parameters
    ----------
    longest_s: upper limit of every wait, s, > 0
    """

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._usual: dict[int, dict[Hashable, _Usual]] = {}
        self._lateness_s = 0.0

    def wait_s(self, unit: int, request: Hashable) -> float:
        """How long the answer of this unit to this request may take."""
        usual = self._usual.get(unit, {}).get(request)
        if usual is None or usual.missed or usual.count < _LEARNT:
            return self._longest_s
        more_s = max(_DEVIATIONS * usual.deviation_s, _LATENESS * self._lateness_s)
        return min(self._longest_s, max(_SHORTEST_S, usual.mean_s + more_s))

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
            usual.missed = False

    def missed(self, unit: int) -> None:
        """Record that a unit did not answer in time."""
        for usual in self._usual.get(unit, {}).values():
            usual.missed = True
