"""Rests: how long a unit is left alone after an answer or a connection, because it is busy then or needs the time."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

COPIES_S = 60.0
"""How long after a copy of an answer more are expected of the unit."""
_STEPS_S = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4)
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
_SWALLOWED = 2
"""So many requests must be swallowed at least: one may be lost."""
_BUSY_S = 0.05
"""The first rest after a unit has said that it is busy; each one after it, until it answers, is twice as long."""
_MOST_BUSY = 3
"""So often it is doubled."""
_COPY_S = 0.2
"""No copy is waited for longer than this."""


@dataclass(slots=True)
class _Rest:
    least_s: float = 0.0
    """As it is stated."""
    answered_s: float = -inf
    busy_until_s: float = -inf
    busy: int = 0
    """How often in a row it has said so."""
    copied_s: float = -inf
    """When a copy was heard."""
    copy_s: float = 0.0
    """How long after its answer one came, at most."""
    step: int = 0
    missed: int = 0
    """Of those that came soon, in a row; an answer to one that came later than all of these says nothing."""
    missed_gap_s: float = 0.0
    """How long after an answer the latest of these came."""
    answers: int = 0
    """After just this rest."""
    most: int = _TRIED
    """After how many of them one request is sent without it."""
    gap_s: float = inf
    """How long after an answer the request that is under way was sent."""
    soon: bool = False
    """Whether that is soon."""
    without: bool = False
    """Whether it was sent without the rest."""
    not_before_s: float = -inf


class Rests:
    """Learns the rest that each unit needs after an answer: some ignore or refuse what comes sooner, or cannot pass it
    on; some say that they are busy; of some each answer comes twice.

    Times are monotonic seconds.

    Parameters
    ----------
    settle_s: after each connection nothing is asked for so long
    line_s: nor after any answer
    steps_s: rests that are tried one after the other, beginning with 0
    """

    def __init__(self, settle_s: float = 0.0, line_s: float = 0.0, steps_s: Sequence[float] = _STEPS_S) -> None:
        self._of: dict[int, _Rest] = {}
        self._settle_s, self._line_s, self._steps_s = settle_s, line_s, steps_s
        self._opened_s = self.line_answered_s = -inf
        self._swallowed: dict[int, list[float]] | None = None
        """When the first requests to each unit were sent on this connection, until one is answered; None: one was."""
        self._mute_s: float | None = 0.0
        """What the last connection swallowed at first, at most; None: one did not."""
        self.needed_s: dict[int, float] = {}
        """The rests that are certain, by unit."""

    def state(self, unit: int, least_s: float) -> None:
        """The unit is never asked sooner than this after an answer."""
        one = self._of.setdefault(unit, _Rest())
        one.least_s = max(one.least_s, least_s)

    @property
    def are_several(self) -> bool:
        """Whether more than one unit is asked."""
        return len(self._of) > 1

    @property
    def mute_s(self) -> float:
        """For how long each connection so far ignored what came; 0: not known, or one did not."""
        return self._mute_s or 0.0

    def opened(self, now_s: float) -> None:
        """A connection begins."""
        self._opened_s, self._swallowed = now_s, {}

    def left_s(self, unit: int, now_s: float, *, first: bool) -> float:
        """How much longer it rests; not above 0: it may be asked.

        first: other units wait for this, so that no long rest is tried that has not helped yet
        """
        line_s = max(self._opened_s + self._settle_s, self.line_answered_s + self._line_s)
        if (one := self._of.get(unit)) is None:
            return line_s - now_s
        until_s = max(line_s, one.busy_until_s, one.answered_s + one.least_s)
        is_tried = not one.answers and one.most == _TRIED
        waits = first and is_tried and self.are_several and self._steps_s[one.step] >= _SOON_S
        if one.step and one.answers < one.most and not waits:
            until_s = max(until_s, one.answered_s + self._steps_s[one.step])
        if self.sends_copies(unit, now_s):
            until_s = max(until_s, one.answered_s + min(1.25 * one.copy_s, _COPY_S))
        return until_s - now_s

    def is_busy(self, unit: int) -> bool:
        """Whether it has just said that it is busy."""
        one = self._of.get(unit)
        return one is not None and one.busy > 0

    def answered_s(self, unit: int) -> float:
        """When it was last answered."""
        one = self._of.get(unit)
        return -inf if one is None else one.answered_s

    def sent(self, unit: int, now_s: float) -> None:
        """A request is sent."""
        if self._swallowed is not None:
            first = self._swallowed.setdefault(unit, [])
            if len(first) < _SWALLOWED:
                first.append(now_s)
        one = self._of.setdefault(unit, _Rest())
        one.gap_s = now_s - one.answered_s
        one.soon = one.gap_s < max(_SOON_S, 1.2 * self._steps_s[one.step])
        one.without = one.gap_s < 0.9 * self._steps_s[one.step]

    def heard(self, unit: int, sent_s: float) -> None:
        """The unit has answered what was sent then."""
        if self._swallowed is None:
            return
        earlier = sum(s < sent_s for s in self._swallowed.get(unit, ()))
        self._swallowed = None
        if self._mute_s is not None:
            self._mute_s = max(self._mute_s, sent_s - self._opened_s) if earlier >= _SWALLOWED else None

    def answered(self, unit: int, now_s: float) -> None:
        """It is answered."""
        one = self._of.setdefault(unit, _Rest())
        one.answered_s, one.busy, one.busy_until_s = now_s, 0, -inf
        if one.without and one.step:  # it needs none
            one.step, one.answers, one.most = 0, 0, _TRIED
        elif one.soon and one.step:
            one.answers += 1
        if one.gap_s <= one.missed_gap_s:
            one.missed, one.missed_gap_s = 0, 0.0
        one.soon = one.without = False

    def not_reached(self, unit: int, now_s: float) -> None:
        """Its answer says that it could not be asked."""
        self.missed(unit, now_s)
        self._of[unit].answered_s = now_s

    def was_busy(self, unit: int, now_s: float) -> None:
        """Its answer says that it is busy."""
        self.missed(unit, now_s, is_busy=True)
        one = self._of[unit]
        one.answered_s, one.busy_until_s = now_s, now_s + _BUSY_S * 2 ** min(one.busy, _MOST_BUSY)
        one.busy += 1

    def missed(self, unit: int, now_s: float, *, is_busy: bool = False) -> None:
        """It is not answered.

        is_busy: it says why, so that nothing is certain
        """
        one = self._of.setdefault(unit, _Rest())
        soon, without = one.soon, one.without
        one.soon = one.without = False
        if without and one.answers >= one.most:  # it does need it
            one.answers, one.most = 0, _CONFIRMED
            if not is_busy:
                self.needed_s.setdefault(unit, self._steps_s[one.step])
        if without or not soon:
            return
        one.missed, one.missed_gap_s = one.missed + 1, max(one.missed_gap_s, one.gap_s)
        trying = one.step and not one.answers and one.most == _TRIED
        if now_s < one.not_before_s or (one.missed < _SUSPECTED and not trying):
            return
        one.step, one.missed, one.missed_gap_s, one.answers, one.most = one.step + 1, 0, 0.0, 0, _TRIED
        if one.step == len(self._steps_s):
            one.step, one.not_before_s = 0, now_s + _GIVEN_UP_S

    def sends_copies(self, unit: int, now_s: float) -> bool:
        """Whether copies of its answers have come lately."""
        one = self._of.get(unit)
        return one is not None and now_s - one.copied_s < COPIES_S

    def copied(self, unit: int, after_s: float, now_s: float) -> None:
        """A copy of its answer came so long after it; 0: nobody knows how long."""
        one = self._of.setdefault(unit, _Rest())
        if not self.sends_copies(unit, now_s):
            one.copy_s = 0.0
        one.copied_s, one.copy_s = now_s, max(one.copy_s, after_s)
