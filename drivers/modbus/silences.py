"""The requests that a unit leaves unanswered although it answers others: when each is asked again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.base import NoAnswer
from drivers.modbus.numbers import AddressRange, Block

_FIRST_S = 1.0
"""How long after a miss a single place is asked for again."""
_LONGEST_S = 60.0
"""The same, at most."""


@dataclass(slots=True)
class Silence:
    """One such request."""

    request: Block
    places: Sequence[AddressRange]
    """What it is to read."""
    again_s: float
    """When it is asked again."""
    wait_s: float = _FIRST_S
    """How long it is left alone after the next miss."""


class Silences:
    """Those of one unit. Times are monotonic seconds.

    Parameters
    ----------
    error: of a request: why its channels have no value
    """

    def __init__(self, error: Callable[[Block], NoAnswer]) -> None:
        self._error = error
        self._all: list[Silence] = []
        self.places: dict[AddressRange, NoAnswer] = {}
        """What they were to read, and why it has no value."""

    def clear(self) -> None:
        """Forget all of them."""
        self._all.clear()
        self.places.clear()

    def add(self, request: Block, places: Sequence[AddressRange], now_s: float) -> None:
        """The unit leaves this request unanswered."""
        self._all.append(Silence(request, places, now_s))
        self.places.update(dict.fromkeys(places, self._error(request)))

    def of(self, request: Block) -> Silence:
        """Raises KeyError if the request is not among them."""
        for one in self._all:
            if one.request == request:
                return one
        raise KeyError(request)

    def due(self, now_s: float) -> Silence | None:
        """The one that has waited longest to be asked again; None: none is due."""
        return min((one for one in self._all if one.again_s <= now_s), key=lambda one: one.again_s, default=None)

    def remove(self, one: Silence) -> None:
        """It is answered, or divided."""
        self._all.remove(one)
        for place in one.places:
            del self.places[place]

    def missed(self, one: Silence, now_s: float) -> None:
        """It was asked for again in vain."""
        one.again_s = now_s + one.wait_s
        one.wait_s = min(2 * one.wait_s, _LONGEST_S)
