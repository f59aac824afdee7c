"""The read requests for a device's registers and bits, even if the device refuses some or leaves them unanswered."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

from drivers.base import DriverError, NoAnswer, Refused
from drivers.modbus.answers import Words
from drivers.modbus.numbers import BIT_FUNCTIONS, AddressRange, Block
from drivers.modbus.silences import Silences

_MOST_BITS = 2000
_SURE = 2
"""After so many refusals in a row a request that was never answered counts as refused."""
_SURE_AFTER_ANSWERS = 4
"""The same of one that has been answered before."""
_SURE_OF_FAILURE = 16
"""The same of such a one if the unit says that it fails, not that it lacks what is asked for."""
_SILENT = 7
"""How often in a row a request goes unanswered, while the unit answers others, before it is left out; one that had the
full time for its answer counts twice."""


class ReadPlan:
    """The requests that cover some places, and the places that the unit refuses or says nothing of.

    A refused request is divided until each refused place is known. What is left of it is then joined again, so that a
    wrong address costs requests only once. A request that the unit leaves unanswered is taken out, and divided when it
    is asked again, one part at a time; what is answered then comes back.

    Parameters
    ----------
    places: what is to be read
    max_registers, max_gap: as in `plan_blocks`
    silence: the error of a request that is left out
    wholes: requests that the unit answers only as they are
    """

    def __init__(
        self,
        places: Iterable[AddressRange],
        max_registers: int,
        max_gap: int,
        silence: Callable[[Block], NoAnswer],
        wholes: Sequence[Block] = (),
    ) -> None:
        self._places = sorted(set(places))
        self._max_registers, self._wholes = max_registers, wholes
        self._whole = plan_blocks(self._places, max_registers, max_gap, wholes)
        self._silences = Silences(silence)
        self._unanswered: Counter[Block] = Counter()
        """How often in a row each request went unanswered while the unit answered others."""
        self._tests = 0
        self.reset()

    def reset(self, *, silent: bool = True) -> None:
        """Ask for every place again; silent: also for those that the unit says nothing of."""
        if silent:
            self._silences.clear()
        self.requests: list[Block] = [part for block in self._whole for part in self._without_silent(block)]
        self.refused: dict[AddressRange, Refused] = {}
        self._error: Refused | None = None
        self._divided: set[AddressRange] = set()
        self._joined = False
        self._answered: set[Block] = set()
        self._refusals: Counter[Block] = Counter()
        """How often each request was refused in a row."""

    @property
    def is_refused(self) -> bool:
        """Whether the unit refuses all of it."""
        return self._error is not None and not self.requests

    @property
    def lost(self) -> Mapping[AddressRange, DriverError]:
        """The places that the unit refuses or says nothing of, and why they have no value."""
        return {**self.refused, **self._silences.places}

    @property
    def test(self) -> Block:
        """A request that shows whether the unit answers."""
        return self._whole[self._tests % len(self._whole)]

    def test_missed(self) -> None:
        """The test was not answered: next time try another request, as the unit may be silent for this one alone."""
        self._tests += 1

    def was_planned(self, request: Block) -> bool:
        """Whether this was asked for at first."""
        return request in self._whole

    @property
    def error(self) -> Refused:
        """How the first request was refused. Raises ValueError if none was."""
        if self._error is None:
            raise ValueError("nothing was refused")
        return self._error

    @property
    def surest_first(self) -> Sequence[Block]:
        """The requests; the last ones are those that the unit did not answer lately, though it answered others."""
        return (
            sorted(self.requests, key=lambda request: request in self._unanswered)
            if self._unanswered
            else self.requests
        )

    def needed(self, words: Words) -> Words:
        """Those words of the places that the requests have read."""
        return {
            (function, address): words[function, address]
            for function, start, width in self._places
            for address in range(start, start + width)
            if (function, address) in words
        }

    def unused(self, request: Block) -> str:
        """The addresses that the request reads and nothing needs, in words; empty: none."""
        inside = [] if request in self._wholes else self._inside(request)
        gaps = [(one[1] + one[2], other[1] - 1) for one, other in pairwise(inside) if other[1] > one[1] + one[2]]
        return ", ".join(f"{first}" if first == last else f"{first}-{last}" for first, last in gaps)

    def answered(self, request: Block) -> None:
        """The unit has answered the request."""
        self._unanswered.pop(request, None)
        if request not in self._answered or self._refusals:
            self._answered.add(request)
            del self._refusals[request]

    def has_answered(self, request: Block) -> bool:
        """Whether the unit has answered this request."""
        return request in self._answered

    def is_certain(self, request: Block, error: Refused) -> bool:
        """The unit has refused the request: whether that need not be asked again.

        On a serial line it may have been the late refusal of another request: refusals do not say what they refuse.
        """
        self._refusals[request] += 1
        enough = _SURE
        if request in self._answered:
            enough = _SURE_AFTER_ANSWERS if error.absent else _SURE_OF_FAILURE
        return self._refusals[request] >= enough

    def divide(self, request: Block, error: Refused) -> None:
        """The unit refuses this one of the requests: ask for its parts instead, unless it is a single place."""
        self._error = self._error or error
        inside = self._inside(request)
        self._divided.update(inside)
        at = self.requests.index(request)
        if len(inside) == 1 or request in self._wholes:
            self.refused.update(dict.fromkeys(inside, error))
            del self.requests[at]
            return
        self.requests[at : at + 1] = [_cover(part) for part in _halves(inside)]

    def fell_silent(self, request: Block, now_s: float, *, hurried: bool) -> bool:
        """The unit has not answered this one of the requests, but others: whether it is left out now.

        hurried: it had less than the full time
        """
        self._unanswered[request] += 1 if hurried else 2
        if self._unanswered[request] < _SILENT or len(self.requests) == 1:
            return False
        self._unanswered[request] = _SILENT - 1  # once more is enough if everything is asked for again
        self.requests.remove(request)
        self._silences.add(request, self._inside(request), now_s)
        return True

    def silent_due(self, now_s: float) -> Block | None:
        """The request that was left out and is to be asked again; None: none is now."""
        due = self._silences.due(now_s)
        return None if due is None else due.request

    def asked_silent(self, request: Block, now_s: float, *, answered: bool) -> None:
        """What was left out has been asked for. It comes back if it was answered; if not it is divided, or waits for
        longer."""
        one = self._silences.of(request)
        if answered:
            self._silences.remove(one)
            self._unanswered.pop(request, None)
            self.requests = sorted((*self.requests, request), key=lambda block: (block.function, block.address))
        elif len(one.places) > 1 and request not in self._wholes:
            self._silences.remove(one)
            for part in _halves(one.places):
                self._silences.add(_cover(part), part, now_s)
        else:
            self._silences.missed(one, now_s)

    def _without_silent(self, block: Block) -> Sequence[Block]:
        """The requests for what is not left out of this one."""
        inside = [place for place in self._places if holds(block, place)]
        spoken = [place for place in inside if place not in self._silences.places]
        return [block] if len(spoken) == len(inside) else plan_blocks(spoken, self._max_registers, 0, self._wholes)

    def _inside(self, request: Block) -> list[AddressRange]:
        """The places that it is to read."""
        lost = self.lost
        return [place for place in self._places if holds(request, place) and place not in lost]

    def join(self) -> None:
        """All requests are answered: next time ask for neighbouring parts at once.

        Only the first time: if the unit refuses that, too, the parts stay as they are.
        """
        if not self._divided or self._joined:
            return
        self._joined = True
        lost = self.lost
        parts = {place for place in self._divided if place not in lost}
        kept = [r for r in self.requests if not any(holds(r, place) for place in parts)]
        joined = plan_blocks(parts, self._max_registers, 0, self._wholes)
        self.requests = sorted((*kept, *joined), key=lambda block: (block.function, block.address))

    def read_together(self, one: AddressRange, other: AddressRange) -> bool:
        """Whether one request covers both places."""
        return any(holds(request, one) and holds(request, other) for request in self.requests)


def plan_blocks(
    places: Iterable[AddressRange], max_registers: int, max_gap: int, wholes: Sequence[Block] = ()
) -> tuple[Block, ...]:
    """The read requests that cover all places (function, address, width): as few as the device's limit allows.

    Neighbours are joined over a gap of up to max_gap addresses: one request costs about as much as 8 registers. Places
    in one of the wholes are read by that.
    """
    blocks: list[Block] = []
    places = set(places)
    used = {whole for place in places for whole in wholes if holds(whole, place)}
    apart = {place for place in places if not any(holds(whole, place) for whole in used)}
    for function, address, width in sorted(apart):
        limit = _MOST_BITS if function in BIT_FUNCTIONS else max_registers
        if blocks:
            last = blocks[-1]
            end = max(last.address + last.count, address + width)
            gap = address - (last.address + last.count)
            if last.function == function and gap <= max_gap and end - last.address <= limit:
                blocks[-1] = Block(function, last.address, end - last.address)
                continue
        blocks.append(Block(function, address, width))
    return tuple(sorted((*blocks, *used), key=lambda block: (block.function, block.address)))


def holds(block: Block, place: AddressRange) -> bool:
    """Whether the request reads all of the place."""
    function, address, width = place
    return block.function == function and block.address <= address and address + width <= block.address + block.count


def _halves(places: Sequence[AddressRange]) -> tuple[Sequence[AddressRange], Sequence[AddressRange]]:
    """Two parts of several places: divided at the widest gap, otherwise in the middle."""
    gaps = [later[1] - (earlier[1] + earlier[2]) for earlier, later in pairwise(places)]
    middle = gaps.index(max(gaps)) + 1 if max(gaps) > 0 else len(places) // 2
    return places[:middle], places[middle:]


def _cover(places: Sequence[AddressRange]) -> Block:
    function, first, _ = places[0]
    return Block(function, first, max(address + width for _, address, width in places) - first)
