"""The life of a request: which answer is whose, where answers are late, lost, doubled, or carry no number.

| state | meaning | what follows |
|---|---|---|
| sent | its answer is waited for | answered, late |
| late | it was waited for in vain | answered; lost |
| answered | its answer has come | |
| lost | a later request was answered, as units answer in order; or it is too old | |

A request is known by its number, where the wire has one; otherwise by the form of its answer: on a serial line unit,
function and length, by SDO the object. No two requests that differ may wait for answers of one form, so the unit is
first asked for something of another form (`separator`): once that is answered, nothing older can follow.
"""

from collections import deque
from collections.abc import Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf, isinf
from typing import Generic, Protocol, Self, TypeVar

from drivers.patience import LONGER
from drivers.rests import COPIES_S

_FORGOTTEN_S = 10.0
"""No answer comes later than this, but for the last ones."""
_NOT_FORGOTTEN = 3
"""So many: a server that is behind keeps an answer until it hears another request, however many it has not heard."""
_NEWEST = 1 / 4
"""Weight of the newest answer in what is known of a unit's lateness."""
_IS_LATE = 0.5
"""Above this share of missing answers that came in the end they count as late; until one is known, it is `_UNKNOWN`."""
_UNKNOWN = 0.4
_IS_LOST = 0.2
"""Below this share they count as lost."""
_LATELY = 4
"""So many answers."""
_RECENT_S = 0.5
"""No copy of an answer comes later than this."""
_AT_ONCE_S = 0.08
"""The same of one that looks like the answer to the next equal request: no unit is polled as often as this."""
_MOST_RECENT = 16
_EQUAL_OFTEN = 3
"""After this many checks two blocks that hold the same words are no longer suspected."""


class Asked(Hashable, Protocol):
    """What a request asks for."""

    def is_answered_by(self, message: bytes) -> bool:
        """Whether a message has the form of its answer, or of its refusal."""

    def is_like(self, other: Self, /) -> bool:
        """Whether the answers of one unit to both have the same form."""

    def another(self, due: Sequence[Self], refused: Sequence[Self], /) -> Self:
        """Something else to ask, of which the answer has another form, and none that is due if possible.

        refused: those of them that may have been refused
        """


B = TypeVar("B", bound=Asked)

REFUSED = 0x80
"""Bit of the first byte of a Modbus exception, and of an SDO abort."""


@dataclass(slots=True)
class Request(Generic[B]):
    """One request without an answer."""

    block: B
    sent_s: float
    number: int = 0
    """Of the transaction, where the wire has one."""
    is_old: bool = False
    """Whether something else has been asked since: its answer is not used."""
    is_late: bool = False
    first_s: float | None = None
    """When the first of several equal requests was sent, if only one of them has been answered."""
    is_passed: bool = False
    """Whether a later one was answered, so that its own answer is lost, or has been overtaken by a moment."""
    may_be_answered: bool = False
    """Whether something has come that may have been its answer, or a copy of another one."""
    may_be_refused: bool = False
    """Whether a refusal has come that may have been its answer, or that of an earlier request."""


@dataclass(frozen=True, slots=True)
class Came:
    """An answer."""

    unit: int
    """That it names: behind a host with numbers it may be another."""
    message: bytes
    """Function code and data."""
    sent_s: float
    """When its request was sent."""
    number: int = 0
    """Of the transaction, where the wire has one."""


@dataclass(frozen=True, slots=True)
class _Recent(Generic[B]):
    block: B
    message: bytes
    at_s: float


@dataclass(slots=True)
class _Unit(Generic[B]):
    open: list[Request[B]] = field(default_factory=list)
    """In the order in which they were sent."""
    came: dict[B, Came] = field(default_factory=dict)
    """Answers to the present question that have not been taken yet."""
    late_share: float = _UNKNOWN
    late_s: float = 0.0
    """How long late answers take."""
    took_s: deque[float] = field(default_factory=lambda: deque(maxlen=_LATELY))
    """How long its latest answers took."""
    was_heard: bool = False
    """Whether a late answer has come that has not been told of."""
    recent: deque[_Recent[B]] = field(default_factory=lambda: deque(maxlen=_MOST_RECENT))
    """The latest answers."""
    copied_s: float = -inf
    """When a copy was heard."""
    not_copied: int = 0
    """How often an answer that may have been one was none."""
    equal: dict[tuple[B, B], int] = field(default_factory=dict)
    """How often two blocks were found to really hold the same words."""

    @property
    def least_s(self) -> float:
        """How long its answers take at least, lately."""
        return min(self.took_s) if len(self.took_s) > 1 else 0.0

    def missing(self, *, came: bool, took_s: float = 0.0) -> None:
        """What has become of an answer that was waited for in vain."""
        self.late_share += _NEWEST * (came - self.late_share)
        if came:
            self.late_s = max(took_s, self.late_s + _NEWEST * (took_s - self.late_s))

    def passes(self, answered: Request[B]) -> None:
        """Units answer in order: what was sent before this, which is answered, is not answered any more. Unless this is
        a copy: it shows nothing of what has had no answer yet."""
        for request in self.open[: self.open.index(answered)]:
            if request.may_be_answered and not request.is_passed:
                self.not_copied += 1
            request.is_passed |= request.may_be_answered or not answered.may_be_answered

    def hears(self, request: Request[B], message: bytes, now_s: float) -> None:
        """This is its answer, or a copy of another one: then its own is still to come."""
        if request.may_be_answered and not message[0] & REFUSED:  # a refusal may be that of a later request
            self.copied_s = now_s
        request.may_be_answered = self._may_be_a_copy(request.block, message, now_s)
        self.recent.append(_Recent(request.block, message, now_s))

    def _may_be_a_copy(self, block: B, message: bytes, now_s: float) -> bool:
        """Whether this may be a copy of the answer just before to an equal request.

        A refusal does not say what it refuses; only of units that send copies it is suspected.
        """
        if self.not_copied >= _EQUAL_OFTEN and isinf(self.copied_s):
            return False
        equal = [r for r in self.recent if r.message == message and now_s - r.at_s <= _AT_ONCE_S]
        if message[0] & REFUSED:
            return bool(equal) and now_s - self.copied_s < COPIES_S
        return any(r.block == block for r in equal)

    def like(self, block: B, now_s: float) -> Iterator[_Recent[B]]:
        """Recent answers to other requests whose copies would look like the answer to this one."""
        return (r for r in self.recent if r.block != block and r.block.is_like(block) and now_s - r.at_s <= _RECENT_S)


class Requests(Generic[B]):
    """The requests on one link, unit by unit. Times are monotonic seconds.

    numbered: answers carry the number of their request, and may come in any order
    copied: where they do not, an answer may be a copy of an earlier one
    """

    def __init__(self, *, numbered: bool, copied: bool = True) -> None:
        self._numbered, self._copied = numbered, copied
        self.asked = 0
        """The unit that is being asked; 0: none is."""
        self._units: dict[int, _Unit[B]] = {}

    def _of(self, unit: int) -> _Unit[B]:
        if unit not in self._units:
            self._units[unit] = _Unit()
        return self._units[unit]

    def clear(self) -> None:
        """The connection is new: what was sent on another is lost."""
        for one in self._units.values():
            one.open.clear()
            one.came.clear()

    def begin(self, unit: int, now_s: float) -> None:
        """A new question: what was sent before is not of use any more."""
        one = self._of(unit)
        one.came.clear()
        passed = [r for r in one.open if r.is_passed]
        for request in passed:
            one.open.remove(request)
            if not request.may_be_answered:
                one.missing(came=False)
        for request in one.open:
            request.is_old = True
        while len(one.open) > _NOT_FORGOTTEN and now_s - one.open[0].sent_s > _FORGOTTEN_S:
            del one.open[0]
            one.missing(came=False)

    def sent(self, unit: int, block: B, now_s: float, number: int = 0) -> None:
        """This was sent."""
        self._of(unit).open.append(Request(block, now_s, number))

    def open(self, unit: int, block: B, *, old: bool = False) -> list[Request[B]]:
        """The requests for it that belong to the present question, oldest first; old: also to earlier ones."""
        waiting = (r for r in self._waiting(unit) if not r.may_be_answered)
        return [r for r in waiting if r.block == block and (old or not r.is_old)]

    def _waiting(self, unit: int) -> list[Request[B]]:
        """The requests of which an answer is expected."""
        return [r for r in self._of(unit).open if not r.is_passed]

    def may_be_refused(self, unit: int, message: bytes) -> bool:
        """Whether this refusal may be the answer to a request of this unit."""
        return any(r.block.is_answered_by(message) for r in self._of(unit).open)

    def missed(self, unit: int, block: B) -> None:
        """Its answer was waited for in vain."""
        for request in self.open(unit, block):
            request.is_late = True

    def withdraw(self, unit: int) -> None:
        """Nobody waits for the unit's answers any more."""
        for request in self._of(unit).open:
            request.is_old = True

    def spoilt(self, unit: int, block: B) -> None:
        """The answer to the oldest request for it has come and is of no use."""
        if open_ := self.open(unit, block):
            self._of(unit).open.remove(open_[0])

    def took(self, unit: int, block: B) -> Came | None:
        """The answer to the present question; only once."""
        return self._of(unit).came.pop(block, None)

    def due(self, *, recent: bool = False) -> Iterator[tuple[int, B]]:
        """By unit, what the answers that may come are to; recent: what copies of those that have come are to."""
        return ((u, r.block) for u, one in self._units.items() for r in (one.recent if recent else one.open))

    def came(self, unit: int, message: bytes, now_s: float, number: int = 0) -> bool:
        """An answer has come. Returns False if none was due.

        One that comes in the time of another unit is not used, unless its unit is known to be late: it may show a line
        that is to be mended.
        """
        one, fitting = self._fitting(unit, message, number)
        if not fitting:
            return False
        request = fitting[0]
        in_turn = not self.asked or self._units.get(self.asked) is one or one.late_share > _IS_LATE
        was_copied = request.may_be_answered
        if not self._numbered:
            if self._copied:
                one.hears(request, message, now_s)
            one.passes(request)
        if not request.may_be_answered:
            one.open.remove(request)
        one.took_s.append(now_s - request.sent_s)
        first_s = request.sent_s if request.first_s is None else request.first_s
        equal = [r for r in fitting[1:] if r.block == request.block]
        for other in equal:  # which of them was answered shows when, and whether, the other answer comes
            other.is_late, other.first_s = True, first_s
        if request.is_late and not equal:
            one.missing(came=True, took_s=now_s - first_s)
            one.was_heard = True
        if message[0] & REFUSED:
            for other in fitting[1:]:
                other.may_be_refused = True
        if (
            in_turn
            and not (was_copied or request.is_old)
            and all(r.block == request.block and not r.is_old for r in fitting)
        ):
            one.came.setdefault(request.block, Came(unit, message, request.sent_s, number))
        return True

    def _fitting(self, unit: int, message: bytes, number: int) -> tuple[_Unit[B], list[Request[B]]]:
        """The unit that was asked, and the requests that this may answer."""
        if not self._numbered:
            one = self._of(unit)
            fitting = [r for r in one.open if r.block.is_answered_by(message)]
            return one, [r for r in fitting if not r.is_passed] or [r for r in fitting if not r.is_old]
        for one in self._units.values():
            for request in one.open:
                if request.number == number:
                    return one, [request]
        return self._of(unit), []

    @property
    def numbers(self) -> list[int]:
        """Of the transactions without an answer."""
        return [r.number for one in self._units.values() for r in one.open]

    def separator(self, unit: int, block: B) -> B | None:
        """The request that must be answered first, because an old answer may look like this block's; None: none may.

        The unit may refuse it. It may have been sent already.
        """
        if self._numbered:
            return None
        sent = self._waiting(unit)
        like = [n for n, r in enumerate(sent) if r.block.is_like(block) and (r.block != block or r.is_old)]
        if not like:
            return None
        after = (r.block for r in reversed(sent[like[-1] + 1 :]) if not (r.block.is_like(block) or r.may_be_refused))
        return next(after, None) or self.another(unit, block)

    def expects(self, unit: int, block: B) -> bool:
        """Whether an answer to such a request may come, whatever question it belongs to."""
        return any(r.block == block for r in self._waiting(unit))

    def another(self, unit: int, block: B) -> B:
        """Something else to ask, whose answer is not taken for that to this block."""
        open_ = self._of(unit).open
        return block.another([r.block for r in open_], [r.block for r in open_ if r.may_be_refused])

    def patience_s(self, unit: int) -> float:
        """For how long after a request its late answer is waited for, before the request is sent again; 0: not.

        To a unit that is busy, each repeated request is one more that it has to answer.
        """
        one = self._of(unit)
        return LONGER * one.late_s if one.late_share > _IS_LATE else 0.0

    def least_s(self, unit: int) -> float:
        """How long an answer of the unit takes at least, lately."""
        return self._of(unit).least_s

    def is_late(self, unit: int) -> bool:
        """Whether its missing answers usually come in the end."""
        return self._of(unit).late_share > _IS_LATE

    def all_slower(self, than_s: float) -> bool:
        """Whether no answer of any unit comes sooner, lately."""
        return all(one.least_s > than_s for one in self._units.values())

    def loses(self, unit: int) -> bool:
        """Whether its missing answers are usually lost, so that waiting longer for one is of no use."""
        return self._of(unit).late_share < _IS_LOST

    @property
    def late(self) -> Collection[int]:
        """The units of which late answers have come that nobody has been told of."""
        return {unit for unit, one in self._units.items() if one.was_heard}

    def was_heard(self, unit: int) -> bool:
        """Whether late answers of this unit have come since this was called last."""
        one = self._of(unit)
        heard, one.was_heard = one.was_heard, False
        return heard

    # A radio link or a repeater may send an answer twice, and the copy looks like the answer to another request.

    def copy_s(self, unit: int, message: bytes, now_s: float) -> float | None:
        """How long after its answer this copy of it comes; None: it is not one."""
        one = self._of(unit)
        at_s = max((r.at_s for r in one.recent if r.message == message), default=-inf)
        if now_s - at_s > _RECENT_S:
            return None
        one.copied_s = now_s
        return now_s - at_s

    def is_doubtful(self, unit: int, block: B, message: bytes, now_s: float) -> bool:
        """Whether this may be a copy of an answer to another request."""
        one, doubtful = self._of(unit), False
        if self._numbered or message[0] & REFUSED:
            return False
        for recent in one.like(block, now_s):
            if recent.message != message:
                one.equal.pop((recent.block, block), None)
            elif one.equal.get((recent.block, block), 0) < _EQUAL_OFTEN:
                doubtful = True
        return doubtful

    def doubt(self, unit: int, block: B, sent_s: float) -> None:
        """This answer of that request may be a copy of another one: then its own is still to come."""
        open_ = self._of(unit).open
        at = next((n for n, r in enumerate(open_) if r.sent_s > sent_s), len(open_))
        open_.insert(at, Request(block, sent_s, may_be_answered=True))

    def confirmed(self, unit: int, block: B, message: bytes, now_s: float) -> None:
        """A doubtful answer was asked for again, and this came."""
        one = self._of(unit)
        for recent in one.like(block, now_s):
            pair = recent.block, block
            one.equal[pair] = one.equal.get(pair, 0) + 1 if recent.message == message else 0
