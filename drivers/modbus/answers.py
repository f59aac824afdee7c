"""The answers to one question, which may need several requests: each is asked again by itself until it is answered."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from drivers.modbus.numbers import Block

Words = Mapping[tuple[int, int], int]
"""Registers and bits by function and address."""

_SEVERAL = 3


class BlockAnswers:
    """What has been answered since the question began, and whose turn it is.

    A request that is not answered comes after the others, so that one that is late or lost does not take the time of
    the rest. Requests whose answers look like one that may still come are an exception. They wait for that answer,
    unless it was missed several times: the unit may be silent for that request only.
    """

    def __init__(self) -> None:
        self._got: dict[Block, tuple[int, ...]] = {}
        self._missed: list[Block] = []
        """The requests that were not answered, the last one at the end."""
        self._misses: Counter[Block] = Counter()
        """How often each of them was not."""

    def __bool__(self) -> bool:
        return bool(self._got)

    def clear(self) -> None:
        """A new question begins."""
        self._got.clear()
        self._missed.clear()
        self._misses.clear()

    def add(self, request: Block, answer: tuple[int, ...], later: Collection[Block] = ()) -> None:
        """The request is answered.

        later: what must not have been asked before it
        """
        for other in later:
            self._got.pop(other, None)
        self._got[request] = answer

    def missed(self, request: Block) -> None:
        """The request was not answered."""
        if request in self._missed:
            self._missed.remove(request)
        self._missed.append(request)
        self._misses[request] += 1

    def next_of(self, requests: Sequence[Block], *, in_order: bool) -> Block | None:
        """The request to ask now; None: all are answered.

        in_order: none may be asked before those that precede it
        """
        missing = [request for request in requests if request not in self._got]
        if not missing:
            return None
        missed = [request for request in self._missed if request in missing]
        if not missed:
            return missing[0]
        if in_order:
            another = not self._got and len(missing) > 1 and self._missed_often(missing[0])
            return missing[1] if another else missing[0]  # does the unit answer anything at all?
        at = missing.index(missed[-1]) + 1
        for request in missing[at:] + missing[: at - 1]:
            if not any(
                other != request and other.is_like(request) and not self._missed_often(other) for other in missed
            ):
                return request
        return missed[-1]

    def _missed_often(self, request: Block) -> bool:
        return self._misses[request] >= _SEVERAL

    def words(self, requests: Sequence[Block]) -> Words:
        """What these requests, which are all answered, have read."""
        return {
            (request.function, address): word
            for request in requests
            for address, word in enumerate(self._got[request], start=request.address)
        }
