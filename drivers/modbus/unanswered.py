"""The requests on a serial line that have no answer yet. RTU answers are not numbered."""

from collections.abc import Collection
from dataclasses import dataclass

from drivers.modbus.frames import alike, rtu_answers
from drivers.modbus.habits import Habits
from drivers.modbus.numbers import BIT_FUNCTIONS, Block

_SEPARATORS = 4
"""How many lengths of separating answers there are, so that successive ones differ."""


@dataclass(slots=True)
class Asked:
    """One block of one unit."""

    sent: int = 0
    """How many requests may still be answered."""
    since_s: float = 0.0
    """When the first of them was sent."""
    last_s: float = 0.0
    """When the last of them was sent."""
    missed: bool = False
    """Whether its answer was waited for in vain."""
    over: bool = False
    """Whether the question is settled or given up: what still comes is old."""


class Unanswered:
    """Tells which answers may still come, so that none is taken for the answer to a later question.

    A question may be asked several times; any answer to it is accepted. A new question to the unit makes those before
    it old. An old answer and a new one that look the same are told apart by a request between them whose answer has
    another length: a serial unit answers in order, so once that is answered nothing older can follow.
    """

    def __init__(self) -> None:
        self.habits = Habits()
        self._asked: dict[tuple[int, Block], Asked] = {}
        self._came: dict[tuple[int, Block], bytes] = {}
        """Answers to the present question of a unit, heard while another block of it was asked for."""
        self._turn = 0
        self._heard: set[int] = set()

    def begin(self, unit: int) -> None:
        """A new question to this unit begins."""
        for (asked_unit, _), asked in self._asked.items():
            if asked_unit == unit:
                asked.over = True
        for key in [key for key in self._came if key[0] == unit]:
            del self._came[key]

    def took(self, unit: int, block: Block) -> bytes | None:
        """The block's answer to the present question, if it came while another block was asked for; only once."""
        return self._came.pop((unit, block), None)

    def asked(self, unit: int, block: Block) -> Asked:
        """What is known of this block; new if nothing is due."""
        return self._asked.setdefault((unit, block), Asked())

    @property
    def due(self) -> Collection[tuple[int, Block]]:
        """Units and requests of which an answer may still come."""
        return [key for key, asked in self._asked.items() if asked.sent > 0]

    def was_heard(self, unit: int) -> bool:
        """Whether late answers of this unit have been found since this was called last."""
        heard = unit in self._heard
        self._heard.discard(unit)
        return heard

    def settle(self, unit: int, block: Block) -> None:
        """The block's question is settled; forget it, unless more answers may come."""
        asked = self._asked[unit, block]
        asked.over = True
        if asked.sent <= 0:
            del self._asked[unit, block]

    def separator(self, unit: int, block: Block) -> Block | None:
        """The request that must be answered first, because an old answer may look like this block's; None: none may.

        The unit may refuse it.
        """
        due = self._due(unit)
        if not any(alike(other, block) and (other != block or asked.over) for other, asked in due):
            return None
        return self.another(unit, block)

    def another(self, unit: int, block: Block) -> Block:
        """A request at the block's address whose answer looks like none that is due, nor like the block's."""
        counts = range(1, 48, 8) if block.function in BIT_FUNCTIONS else range(1, 7)
        others = [Block(block.function, block.address, count) for count in counts]
        owed = [block, *(other for other, _ in self._due(unit))]
        distinct = [other for other in others if not any(alike(other, one) for one in owed)]
        choice = distinct or [other for other in others if not alike(other, block)]
        self._turn += 1
        chosen = choice[self._turn % min(len(choice), _SEPARATORS)]
        self._asked.pop((unit, chosen), None)
        return chosen

    def _due(self, unit: int) -> list[tuple[Block, Asked]]:
        return [(other, a) for (asked_unit, other), a in self._asked.items() if asked_unit == unit and a.sent > 0]

    def separated(self, unit: int) -> None:
        """The unit has answered a separator: nothing older can follow."""
        for key in [key for key in self._asked if key[0] == unit]:
            for _ in range(self._asked.pop(key).sent):
                self.habits.was_lost(unit)

    def note(self, heard: bytes | bytearray, unit: int = 0, block: Block | None = None) -> None:
        """Strike off the answers that were due and are in what was heard, apart from this block's.

        Those to the present question of the unit that is asked are kept for `took`.

        unit, block: what is asked; 0 and None: nothing is
        """
        if not heard:
            return
        for key, asked in list(self._asked.items()):
            of_unit, of_block = key
            if key == (unit, block) or any(
                other != key and other[0] == of_unit and alike(other[1], of_block) for other in self._asked
            ):  # the one being asked; or it cannot be told which of the two was answered
                continue
            for message in rtu_answers(heard, of_unit, of_block):
                self._heard.add(of_unit)
                self.habits.was_late(of_unit)
                asked.sent -= 1
                # A refusal does not say what it refuses; an answer in another unit's time shows a line to be mended.
                if not asked.over and message[0] == of_block.function and unit in (0, of_unit):
                    self._came[key] = message
            if asked.sent <= 0:
                del self._asked[key]
