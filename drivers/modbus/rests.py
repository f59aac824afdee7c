"""Rests: how long a busy unit is left alone before it is asked again, and which rest a unit needs after each answer."""

from dataclasses import dataclass
from math import inf

_FIRST_S = 0.05
"""The first rest."""
_NEXT_S = 0.1
"""Each one after it, until the unit answers."""


class Rests:
    """The rests of the units on one bus."""

    def __init__(self) -> None:
        self._until_s: dict[int, float] = {}

    def was_busy(self, unit: int, now_s: float) -> None:
        """The unit has just answered that it is busy. now_s: monotonic"""
        self._until_s[unit] = now_s + (_NEXT_S if unit in self._until_s else _FIRST_S)

    def answered(self, unit: int) -> None:
        """The unit is not busy any more, or is asked something new."""
        self._until_s.pop(unit, None)

    def left_s(self, unit: int, now_s: float) -> float:
        """How much longer it rests; not above 0: it may be asked."""
        return self._until_s.get(unit, now_s) - now_s


_STEPS_S = (0.0, 0.05, 0.1, 0.2, 0.4)
"""Rests after an answer that are tried one after the other."""
_SOON_S = 0.15
"""A request that is sent sooner than this after an answer may have come too soon."""
_SUSPECTED = 4
"""How many of those in a row must be missed, with none answered between them, until a rest is tried."""
_TRIED = 1
"""After so many answers with a rest one request is sent without: what helped may have been something else."""
_CONFIRMED = 1000
"""The same, if such a request was missed."""
_GIVEN_UP_S = 60.0
"""How long none is tried after none has helped."""


@dataclass(slots=True)
class _Minimum:
    answered_s: float = -inf
    step: int = 0
    missed: int = 0
    """Of those that came soon, in a row."""
    answers: int = 0
    """After just this rest."""
    most: int = _TRIED
    """After how many of them one request is sent without it."""
    soon: bool = False
    """Whether the request that is under way was sent soon after an answer."""
    without: bool = False
    """Whether it was sent without the rest."""
    not_before_s: float = -inf


class MinimumRests:
    """Learns the rest that a unit needs after each answer: some ignore what comes sooner, or cannot pass it on.

    Times are monotonic seconds. A unit is any key.
    """

    def __init__(self) -> None:
        self._of: dict[int, _Minimum] = {}

    def left_s(self, unit: int, now_s: float, *, first: bool) -> float:
        """How much longer it rests; not above 0: it may be asked.

        first: other units wait for this, so that no rest is tried that has not helped yet
        """
        one = self._of.get(unit)
        if one is None or not one.step or one.answers >= one.most:
            return 0.0
        if first and not one.answers and one.most == _TRIED and len(self._of) > 1:
            return 0.0
        return one.answered_s + _STEPS_S[one.step] - now_s

    def sent(self, unit: int, now_s: float) -> None:
        """A request is sent."""
        one = self._of.setdefault(unit, _Minimum())
        gap_s = now_s - one.answered_s
        one.soon = gap_s < max(_SOON_S, 1.2 * _STEPS_S[one.step])
        one.without = gap_s < 0.9 * _STEPS_S[one.step]

    def answered(self, unit: int, now_s: float) -> None:
        """It is answered."""
        one = self._of.setdefault(unit, _Minimum())
        one.answered_s = now_s
        if one.without and one.step:  # it needs none
            one.step, one.answers, one.most = 0, 0, _TRIED
        elif one.soon and one.step:
            one.answers += 1
        if one.soon:
            one.missed = 0
        one.soon = one.without = False

    def refused(self, unit: int, now_s: float) -> None:
        """Its answer says that it could not be asked."""
        self.missed(unit, now_s)
        self._of[unit].answered_s = now_s

    def missed(self, unit: int, now_s: float) -> None:
        """It is not answered."""
        one = self._of.setdefault(unit, _Minimum())
        soon, without = one.soon, one.without
        one.soon = one.without = False
        if without and one.answers >= one.most:  # it does need it
            one.answers, one.most = 0, _CONFIRMED
        if without or not soon:
            return
        one.missed += 1
        trying = one.step and not one.answers and one.most == _TRIED
        if now_s < one.not_before_s or (one.missed < _SUSPECTED and not trying):
            return
        one.step, one.missed, one.answers, one.most = one.step + 1, 0, 0, _TRIED
        if one.step == len(_STEPS_S):
            one.step, one.not_before_s = 0, now_s + _GIVEN_UP_S
