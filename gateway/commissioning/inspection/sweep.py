"""Everything that a Modbus unit lets be read, what changes while a sensor is warmed, and how it is likely meant."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from drivers.base import BadAnswer, DriverError, NoAnswer, Refused
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block, NumberFormat
from drivers.text import Text
from gateway.commissioning.scan.registers import ORDERS, Meaning, SeenWords

TABLES: Final = (3, 4, 1, 2)
"""Holding registers, input registers, coils, discrete inputs."""
_REGISTERS: Final = (3, 4)
_CHUNK: Final = {1: 1000, 2: 1000, 3: 120, 4: 120}
_FINE: Final = 8
"""Addresses of a refused range that are asked together."""
_MOST_MISSED: Final = 20
"""Requests without an answer, of a unit that has answered others: each takes twice the bus's timeout."""
_FORMS: Final = (
    *((NumberFormat("float32", byte, word), 1.0) for word, byte in ORDERS),
    *((NumberFormat("int16", byte), scale) for byte in ("big", "little") for scale in (0.1, 0.01, 1.0)),
    *((NumberFormat("int32", byte, word), scale) for word, byte in ORDERS for scale in (0.1, 0.01, 0.001)),
)
"""What temperatures are sent as, the usual first."""
_LEAST, _MOST = 1.0, 60.0
"""A temperature in a hall, degC, or the length of a sensor's travel in any unit."""
_LARGEST_CHANGE: Final = 30.0


@dataclass(frozen=True, slots=True)
class Guess:
    """How numbers are likely sent, and where."""

    function: int
    form: NumberFormat
    scale: float
    addresses: tuple[int, ...]
    """At which the numbers begin."""

    def words(self, seen: SeenWords) -> SeenWords:
        """Only the registers of these numbers."""
        width = self.form.registers
        kept = {a + i: seen.words[a + i] for a in self.addresses for i in range(width)}
        return SeenWords(seen.function, kept)

    def meaning(self, unit: str) -> Meaning:
        """For a draft."""
        return Meaning(self.form, self.scale, unit)


async def swept(bus: ModbusBus, unit: int, most: int, tables: Sequence[int] = TABLES) -> Mapping[int, SeenWords]:
    """What each table holds below this address, one request after the other, reads only; tables that refuse everything
    are left out, and so is what is asked for twice without an answer.

    Raises DriverError when the unit does not answer.
    """
    sweep, found = _Sweep(bus, unit), dict[int, SeenWords]()
    for function in tables:
        seen = SeenWords(function)
        for start in range(0, most, _CHUNK[function]):
            if not await sweep.chunk(Block(function, start, min(_CHUNK[function], most - start)), seen):
                break
        if seen.words:
            found[function] = seen
    return found


class _Sweep:
    def __init__(self, bus: ModbusBus, unit: int) -> None:
        self._bus, self._unit = bus, unit
        self._answered, self._missed = False, 0

    async def chunk(self, block: Block, seen: SeenWords) -> bool:
        """Add what the block holds; False if the unit does not know the function."""
        if await self._read(block, seen):
            return True
        if block.address == 0 and not await self._knows(block.function):
            return False
        registers = block.function in _REGISTERS
        for start in range(block.address, block.address + block.count, _FINE):
            fine = Block(block.function, start, min(_FINE, block.address + block.count - start))
            if await self._read(fine, seen):
                continue
            singles = range(start, start + (fine.count if registers else 1))  # of bits only a sample
            for address in singles:
                await self._read(Block(block.function, address, 1), seen)
        return True

    async def _knows(self, function: int) -> bool:
        try:
            await self._asked(Block(function, 0, 1))
        except Refused as error:
            return not (isinstance(error.reason, Text) and error.reason.says("modbus_illegal_function"))
        except NoAnswer:
            return False
        return True

    async def _read(self, block: Block, seen: SeenWords) -> bool:
        """Add the block's words, if it has an answer."""
        try:
            words = await self._asked(block)
        except Refused:
            return False
        except DriverError:
            self._missed += 1
            if self._missed > (_MOST_MISSED if self._answered else len(_REGISTERS)):
                raise
            return False
        seen.words.update(zip(range(block.address, block.address + block.count), words, strict=True))
        return True

    async def _asked(self, block: Block) -> Sequence[int]:
        """Twice if an answer is disturbed or lost."""
        try:
            try:
                words = await self._bus.read("", self._unit, block)
            except (BadAnswer, NoAnswer):
                words = await self._bus.read("", self._unit, block, again=True)
        except Refused:
            self._answered = True
            raise
        self._answered = True
        return words


def changed(before: SeenWords, after: SeenWords) -> list[int]:
    """Addresses whose content is another now."""
    return [address for address, word in sorted(before.words.items()) if after.words.get(address, word) != word]


def guess(before: SeenWords, after: SeenWords) -> Guess | None:
    """The form that makes likely temperatures of most registers that changed, or of all if none did; None: none.

    Neighbours that hold likely numbers of the same form belong to it: one sensor was warmed, and a module has several.
    """
    moved = set(changed(before, after)) or set(before.words)
    best: tuple[tuple[int, int], Guess] | None = None
    for form, scale in _FORMS:
        then, now = before.numbers(form), after.numbers(form)
        likely = [a for a in then if a in now and _likely(then[a] * scale, now[a] * scale)]
        for first in range(form.registers):
            starts = [a for a in likely if a % form.registers == first]
            hit = {word for a in starts for word in range(a, a + form.registers)} & moved
            wrong = {a for a in moved - hit if a in then and a % form.registers == first}
            runs = [run for run in _runs(starts, form.registers) if hit & {w for a in run for w in _of(a, form)}]
            found = Guess(before.function, form, scale, tuple(a for run in runs for a in run))
            score = len(hit) - len(wrong), len(found.addresses)  # shifted by a word, one number less is whole
            if hit and (best is None or score > best[0]):
                best = score, found
    return None if best is None else best[1]


def _of(address: int, form: NumberFormat) -> range:
    return range(address, address + form.registers)


def _likely(then: float, now: float) -> bool:
    return _LEAST <= abs(then) <= _MOST and abs(now - then) <= _LARGEST_CHANGE and now <= 2 * _MOST


def _runs(starts: Iterable[int], width: int) -> Iterator[list[int]]:
    run: list[int] = []
    for start in starts:
        if run and start != run[-1] + width:
            yield run
            run = []
        run.append(start)
    if run:
        yield run
