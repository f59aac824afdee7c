"""Multiplexed messages of a DBC file: which frames hold a signal, according to the selectors above it."""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING

from drivers.can.wanted import Page

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


def pages_of(signal: "Signal", signals: "Mapping[str, Signal]") -> tuple[Page, ...]:
    """What the selectors of a frame must hold for the signal to be in it; also those above a selector.

    signals: all of its message, by name
    """
    found = []
    while signal.multiplexer_signal is not None:
        numbers = signal.multiplexer_ids or []
        signal = signals[signal.multiplexer_signal]
        places = _places(signal)
        found.append(Page(_put((1 << len(places)) - 1, places), frozenset(_put(number, places) for number in numbers)))
    return tuple(found)


def alone(message: "Message", signal: "Signal") -> "Message":
    """A message of this one signal: the library refuses to decode a frame whose selector it does not know, and this
    signal may be in every frame."""
    from cantools.database.can import Message

    plain = copy(signal)
    plain.multiplexer_ids, plain.multiplexer_signal, plain.is_multiplexer = None, None, False
    return Message(
        message.frame_id,
        message.name,
        message.length,
        [plain],
        is_extended_frame=message.is_extended_frame,
        strict=False,
    )


def _places(signal: "Signal") -> Sequence[int]:
    """Where each bit of the signal is in the data as a little-endian number, the lowest first."""
    if signal.byte_order == "little_endian":
        return range(signal.start, signal.start + signal.length)
    places = [signal.start]  # of its highest bit; the next byte follows the lowest bit of this one
    while len(places) < signal.length:
        places.append(places[-1] - 1 if places[-1] % 8 else places[-1] + 15)
    return places[::-1]


def _put(number: int, places: Sequence[int]) -> int:
    return sum(1 << place for i, place in enumerate(places) if number >> i & 1)
