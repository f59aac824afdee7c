"""Unit ids that one device answers to. Some servers use only some bits of the id, others none."""

from collections.abc import Collection, Sequence

from drivers.base import BadAnswer, Busy, ConnectError, NoAnswer, Refused
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block
from gateway.runtime.boundary import contained

UNUSUAL_UNITS = (113, 114, 115)
"""Unit ids that are never used: a host that answers to all of them ignores the id, or refuses every unknown one."""
_COUNTS = (16, 8, 1)
"""How many words are asked for at once: fewer, if that many are refused."""
_REGISTERS = (3, 4)
_BITS = (2, 1)
_MOST_ASKS = 4
_SILENT = "silent"
_CLOSED = "closed"
_UnitAnswer = tuple[int, ...] | str
"""Words, or in words why there are none."""


async def told_apart(bus: ModbusBus, asked: Collection[int], answering: Sequence[int]) -> tuple[list[int], str]:
    """The ids by which the bus distinguishes devices, each device's lowest, and a remark if they are not all.

    asked: every id that was asked; answering: those that were answered, ascending

    Raises UnexpectedError.
    """
    if alike := await _answering_to_every_id(bus, asked, answering):
        kept = [unit for unit in answering if unit not in alike[1:]]
        return kept, f"answers to every unit id: one device, shown as unit {alike[0]}"
    for apart in range(2, bus.units[1] + 1):
        pairs = [(unit, unit + apart) for unit in answering if unit + apart in answering]
        if pairs and _repeats(asked, answering, apart) and await _are_alike(bus, asked, pairs):
            kept = [unit for unit in answering if not any(u in answering for u in range(unit - apart, -1, -apart))]
            one, other = pairs[0]
            return kept, f"repeats its unit ids after {apart}: {one} and {other} are one device; the lowest are shown"
    return list(answering), ""


async def _answering_to_every_id(bus: ModbusBus, asked: Collection[int], answering: Sequence[int]) -> list[int]:
    """The ids that belong to one device that answers to every id; empty: there is no such device."""
    first, *others = UNUSUAL_UNITS
    if any(unit in asked and unit not in answering for unit in UNUSUAL_UNITS):
        return []
    if await _words(bus, first, Block(_REGISTERS[0], 0, 1)) in (_SILENT, _CLOSED):
        return []
    if not all([await are_same(bus, first, other) for other in others]):
        return []
    return [unit for unit in answering if unit == first or await are_same(bus, first, unit)]


def _repeats(asked: Collection[int], answering: Collection[int], apart: int) -> bool:
    """Whether, of any two asked ids at this distance, both answer or neither does."""
    return all(other in answering for unit in answering for other in (unit - apart, unit + apart) if other in asked)


async def _are_alike(bus: ModbusBus, asked: Collection[int], pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether the ids of each pair hold the same words, and one more id does if there is one."""
    (one, other), (low, high) = pairs[0], bus.units
    apart = other - one
    further = next((u for u in range(one % apart, high + 1, apart) if u >= low and u not in asked), None)
    more = [] if further is None else [(one, further)]
    for unit, like in [*pairs, *more]:
        if not await are_same(bus, unit, like):
            return False
    return True


async def are_same(bus: ModbusBus, one: int, other: int) -> bool:
    """Whether both ids hold the same words. One is read before and after the other, to leave out words that change.

    Raises UnexpectedError.
    """
    has_words = False
    for function in (*_REGISTERS, *_BITS):
        if function in _BITS and has_words:
            break
        for count in _COUNTS:
            block = Block(function, 0, count)
            before, between, after = [await _words(bus, unit, block) for unit in (one, other, one)]
            if isinstance(before, str) or isinstance(between, str) or isinstance(after, str):
                if before != between:
                    return False
                if before in (_SILENT, _CLOSED):
                    break
                continue
            if any(a == c != b for a, b, c in zip(before, between, after, strict=True)):
                return False
            has_words = True
            break
    return True


async def _words(bus: ModbusBus, unit: int, block: Block) -> _UnitAnswer:
    why = _SILENT
    for ask in range(_MOST_ASKS):
        try:
            await contained(bus.connect(), "connect")
            return await contained(bus.read("", unit, block, again=ask > 0), f"the request to unit {unit}")
        except Busy:
            continue
        except ConnectError:  # some hosts close the connection on an unknown id
            return _CLOSED
        except Refused as error:
            return error.reason
        except NoAnswer:
            why = _SILENT
        except BadAnswer as error:
            why = error.what
        if ask > 0:
            break
    return why
