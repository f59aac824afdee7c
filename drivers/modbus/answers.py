"""The answers to one question, which may need several requests: each is asked again by itself until it is answered."""

from collections.abc import Mapping, Sequence

from drivers.modbus.frames import alike
from drivers.modbus.numbers import Block

Words = Mapping[tuple[int, int], int]
"""Registers and bits by function and address."""


class BlockAnswers:
    """What has been answered since the question began, and whose turn it is.

    A request that is not answered comes after the others, so that one that is late or lost does not take the time of
    the rest. The exception are requests whose answers look like one that may still come: they wait for it.
    """

    def __init__(self) -> None:
        self._got: dict[Block, tuple[int, ...]] = {}
        self._missed: list[Block] = []
        """The requests that were not answered, the last one at the end."""

    def __bool__(self) -> bool:
        return bool(self._got)

    def clear(self) -> None:
        """A new question begins."""
        self._got.clear()
        self._missed.clear()

    def add(self, request: Block, answer: tuple[int, ...]) -> None:
        """The request is answered."""
        self._got[request] = answer

    def missed(self, request: Block) -> None:
        """The request was not answered."""
        if request in self._missed:
            self._missed.remove(request)
        self._missed.append(request)

    def next_of(self, requests: Sequence[Block], *, in_order: bool) -> Block | None:
        """The request to ask now; None: all are answered.

        in_order: none may be asked before those that precede it
        """
        missing = [request for request in requests if request not in self._got]
        if not missing:
            return None
        missed = [request for request in self._missed if request in missing]
        if in_order or not missed:
            return missing[0]
        at = missing.index(missed[-1]) + 1
        for request in missing[at:] + missing[: at - 1]:
            if not any(other != request and alike(other, request) for other in missed):
                return request
        return missed[-1]

    def words(self, requests: Sequence[Block]) -> Words:
        """What these requests, which are all answered, have read."""
        return {
            (request.function, address): word
            for request in requests
            for address, word in enumerate(self._got[request], start=request.address)
        }
