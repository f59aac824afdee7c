"""Registers and bits of a Modbus unit as they are, the numbers that they may hold, and the draft of a profile."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from drivers.base import BadAnswer, Busy, NoAnswer, Refused
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block, NumberFormat, Order, as_in_manuals
from gateway.commissioning.scan.fragment import CONFIRM
from gateway.config.wires import toml_value

_MOST_ASKS = 8
"""How often a unit that is busy is asked."""
_MOST_REGISTERS = 125
"""In one answer (MODBUS Application Protocol V1.1b3)."""
_MOST_BITS = 2000
"""Likewise, of bits."""
ORDERS: tuple[tuple[Order, Order], ...] = (
    ("big", "big"),
    ("big", "little"),
    ("little", "big"),
    ("little", "little"),
)
"""Every order of registers, and of bytes within a register."""


@dataclass(slots=True)
class SeenWords:
    """What one function of a unit answers at some addresses."""

    function: int
    words: dict[int, int] = field(default_factory=dict)
    """Address to register (0..65535) or bit (0, 1)."""
    refused: dict[int, str] = field(default_factory=dict)
    """Address to the reason why the unit refuses it, in words."""

    @property
    def has_bits(self) -> bool:
        return self.function in (1, 2)

    def runs(self) -> Iterator[tuple[int, list[int]]]:
        """First address and words of each range without a gap."""
        for run in _runs(sorted(self.words)):
            yield run[0], [self.words[address] for address in run]

    def refusals(self) -> Iterator[str]:
        """What the unit refuses, a line for each reason."""
        for reason in dict.fromkeys(self.refused.values()):
            runs = _runs([address for address in sorted(self.refused) if self.refused[address] == reason])
            places = ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
            yield f"function {self.function} at {places}: {reason}"

    def numbers(self, form: NumberFormat) -> Mapping[int, int | float]:
        """The number that begins at each address, as far as all of its registers are known."""
        places = {a: range(a, a + form.registers) for a in sorted(self.words)}
        return {
            a: form.decode([self.words[i] for i in p]) for a, p in places.items() if all(i in self.words for i in p)
        }


async def read_words(bus: ModbusBus, unit: int, function: int, addresses: Sequence[int]) -> SeenWords:
    """Read these addresses, as few requests as possible. A refused range is divided until it is known which address the
    unit refuses; nothing but the read functions 1 to 4 is sent.

    Raises DriverError when the unit does not answer.
    """
    seen = SeenWords(function)
    longest = _MOST_BITS if seen.has_bits else _MOST_REGISTERS
    for run in _runs(sorted(set(addresses))):
        for start in range(0, len(run), longest):
            await _divide(bus, unit, Block(function, run[start], len(run[start : start + longest])), seen)
    return seen


async def _divide(bus: ModbusBus, unit: int, block: Block, seen: SeenWords) -> None:
    try:
        words = await _asked(bus, unit, block)
    except Refused as error:
        if block.count == 1:
            meant = as_in_manuals(block.address)
            seen.refused[block.address] = f"{error.reason} ({meant})" if meant else error.reason
            return
        # Even halves: some units refuse to answer half of a 32-bit number.
        first = 1 if block.count == 2 else (block.count // 2 + 1) & ~1
        await _divide(bus, unit, Block(block.function, block.address, first), seen)
        await _divide(bus, unit, Block(block.function, block.address + first, block.count - first), seen)
        return
    seen.words.update(zip(range(block.address, block.address + block.count), words, strict=True))


async def _asked(bus: ModbusBus, unit: int, block: Block) -> Sequence[int]:
    """Read a block, even if one answer is disturbed or lost, or the unit is busy for a while."""
    for ask in range(_MOST_ASKS):
        try:
            return await bus.read("", unit, block, again=ask > 0)
        except (BadAnswer, NoAnswer):
            if ask > 0:
                raise
        except Busy:
            pass
    return await bus.read("", unit, block, again=True)


def _runs(addresses: Sequence[int]) -> Iterator[list[int]]:
    run: list[int] = []
    for address in addresses:
        if run and address != run[-1] + 1:
            yield run
            run = []
        run.append(address)
    if run:
        yield run


@dataclass(frozen=True, slots=True)
class Meaning:
    """How a person reads the registers, for a draft."""

    form: NumberFormat
    scale: float
    unit: str


def profile_draft(seen: SeenWords, meaning: Meaning, *, place: str, when: str) -> str:
    """A profile of everything that was read: a block for each range without a gap, with the values that it had.

    place: unit and wire, in words; when: the time, in words

    Raises ValueError: nothing was read that holds such a number.
    """
    blocks = (
        [_bit_block(seen.function, first, words) for first, words in seen.runs()]
        if seen.has_bits
        else [
            _block(seen.function, first, words, meaning)
            for first, words in seen.runs()
            if len(words) >= meaning.form.registers
        ]
    )
    if not blocks:
        raise ValueError(f"no {meaning.form.registers} neighbouring registers were read, as {meaning.form.type} needs")
    refused = ", ".join(map(str, sorted(seen.refused)))
    head = [
        f"# Draft by `talc-gateway inspect`: what {place} answered at {when}.",
        f"# {CONFIRM}: the device does not state type, order, scale and unit; compare the values.",
        *([f"# Refused, and left out: {refused}."] if refused else []),
        'protocol = "modbus"',
        f"title = {toml_value(place)}  # {CONFIRM}: which device this is",
        'buses = ["modbus_rtu", "modbus_tcp"]',
        *(["max_gap = 0                 # it refuses addresses between these"] if refused else []),
        f"unit = {toml_value('1' if seen.has_bits else meaning.unit)}",
    ]
    return "\n".join(head) + "\n\n" + "\n\n".join(blocks) + "\n"


def _bit_block(function: int, first: int, bits: Sequence[int]) -> str:
    shown = "".join(map(str, bits))
    return _section(f"seen: {shown}", function, first, len(bits), ['type = "bit"'])


def _block(function: int, first: int, words: Sequence[int], meaning: Meaning) -> str:
    form = meaning.form
    wide = form.registers
    values = [form.decode(words[i : i + wide]) * meaning.scale for i in range(0, len(words) - wide + 1, wide)]
    left = len(words) % wide
    lines = [f"type = {toml_value(form.type)}"]
    if wide > 1:
        lines.append(f"word_order = {toml_value(form.word_order)}")
    if form.byte_order != "big":
        lines.append(f"byte_order = {toml_value(form.byte_order)}")
    if meaning.scale != 1:
        lines.append(f"scale = {meaning.scale!r}")
    if left:
        lines.append(f"# registers from {first + len(words) - left} on are fewer than one {form.type}: left out")
    return _section("seen: " + " ".join(f"{v:.6g}" for v in values), function, first, len(values), lines)


def _section(comment: str, function: int, first: int, channels: int, lines: Sequence[str]) -> str:
    return "\n".join(
        ["[[block]]", f"# {comment}", f"function = {function}", f"address = {first}", f"channels = {channels}", *lines]
    )
