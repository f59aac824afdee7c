"""Recognises answers that come twice, as from a radio link or a repeater, so that none is taken for another's.

The answers on a serial line carry no address, so the second copy of an answer looks like the answer to a request of the
same length for other addresses.
"""

from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from drivers.modbus.frames import alike, rtu_frame
from drivers.modbus.numbers import Block

_RECENT_S = 0.5
"""No copy comes later than this after its answer."""
_MOST_RECENT = 16
"""How many answers of a unit are kept."""
_REMEMBERED_S = 60.0
"""How long after a copy more are expected of the unit."""
_LONGEST_S = 0.2
"""No copy is waited for longer than this."""
_EQUAL_OFTEN = 3
"""After this many checks two blocks that hold the same words are no longer suspected."""
_REFUSAL = 0x80


@dataclass(frozen=True, slots=True)
class _Accepted:
    block: Block
    message: bytes
    at_s: float


@dataclass(slots=True)
class _AnsweringUnit:
    answers: deque[_Accepted] = field(default_factory=lambda: deque(maxlen=_MOST_RECENT))
    copied_s: float | None = None
    """When a copy was last heard."""
    delay_s: float = 0.0
    """How long after its answer it came at most."""
    equal: dict[tuple[Block, Block], int] = field(default_factory=dict)
    """How often two blocks were found to really hold the same words."""

    def like(self, block: Block, now_s: float) -> Iterator[_Accepted]:
        """Recent answers to other requests whose copies would look like the answer to this one."""
        return (a for a in self.answers if a.block != block and alike(a.block, block) and now_s - a.at_s <= _RECENT_S)


class Repeats:
    """The latest answers of each unit, and whether they come twice. All times are monotonic."""

    def __init__(self) -> None:
        self._units: dict[int, _AnsweringUnit] = {}

    def accepted(self, unit: int, block: Block, message: bytes, now_s: float) -> None:
        """This is an answer of the unit. message: function code and data"""
        self._units.setdefault(unit, _AnsweringUnit()).answers.append(_Accepted(block, message, now_s))

    def may_be_copy(self, unit: int, message: bytes, now_s: float) -> bool:
        """Whether the unit has lately answered with the same, and sends copies."""
        known = self._units.get(unit)
        if known is None or known.copied_s is None or now_s - known.copied_s > _REMEMBERED_S:
            return False
        return any(answer.message == message and now_s - answer.at_s <= _RECENT_S for answer in known.answers)

    def is_doubtful(self, unit: int, block: Block, message: bytes, now_s: float) -> bool:
        """Whether this may be a copy of an answer to another request."""
        if (known := self._units.get(unit)) is None or message[0] & _REFUSAL:
            return False
        doubtful = False
        for answer in known.like(block, now_s):
            pair = answer.block, block
            if answer.message != message:
                known.equal.pop(pair, None)
            elif known.equal.get(pair, 0) < _EQUAL_OFTEN:
                doubtful = True
        return doubtful

    def checked(self, unit: int, block: Block, message: bytes, now_s: float) -> None:
        """A doubtful answer was asked for again, and this came."""
        known = self._units[unit]
        for answer in known.like(block, now_s):
            pair = answer.block, block
            known.equal[pair] = known.equal.get(pair, 0) + 1 if answer.message == message else 0

    def note(self, heard: bytes | bytearray, now_s: float, due: Collection[tuple[int, Block]]) -> bool:
        """Look for copies in what was heard; returns whether there is one.

        due: units and requests of which an answer is expected anyway
        """
        found = False
        for unit, known in self._units.items():
            for answer in known.answers:
                if now_s - answer.at_s > _RECENT_S or (unit, answer.block) in due:
                    continue
                if rtu_frame(bytes((unit,)) + answer.message) in heard:
                    known.copied_s, known.delay_s = now_s, now_s - answer.at_s
                    found = True
        return found

    def expected_s(self, unit: int, block: Block, now_s: float) -> float:
        """How long a copy may still come that looks like the answer to this request; 0: none is expected."""
        known = self._units.get(unit)
        if known is None or known.copied_s is None or now_s - known.copied_s > _REMEMBERED_S:
            return 0.0
        wait_s = min(2 * known.delay_s, _LONGEST_S)
        return max((answer.at_s + wait_s - now_s for answer in known.like(block, now_s)), default=0.0)
