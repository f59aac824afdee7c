"""Signals of a DBC file: which frames hold one, according to the selectors above it, and where in them it is."""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING

from drivers.can.dbc_file import places
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
        at = _places(signal)
        found.append(Page(_put((1 << len(at)) - 1, at), frozenset(_put(number, at) for number in numbers)))
    return tuple(found)


def alone(message: "Message", signal: "Signal") -> "Message":
    """A message of this one signal, as long as the signal needs: a frame without the others, or with a selector that
    the file does not know, still holds it."""
    from cantools.database.can import Message

    plain = copy(signal)
    plain.multiplexer_ids, plain.multiplexer_signal, plain.is_multiplexer = None, None, False
    return Message(
        message.frame_id,
        message.name,
        max(_places(signal)) // 8 + 1,
        [plain],
        is_extended_frame=message.is_extended_frame,
        strict=False,
    )


def overlapping(signal: "Signal", signals: "Mapping[str, Signal]") -> str:
    """The name of another signal of its message that has a bit of it in the same frames; empty: there is none."""
    bits, pages = set(_places(signal)), pages_of(signal, signals)
    for name, other in signals.items():
        if other is not signal and not bits.isdisjoint(_places(other)):
            others = pages_of(other, signals)
            if not any(one.mask == its.mask and not one.values & its.values for one in pages for its in others):
                return name
    return ""


def _places(signal: "Signal") -> Sequence[int]:
    return places(signal.start, signal.length, little_endian=signal.byte_order == "little_endian")


def _put(number: int, at: Sequence[int]) -> int:
    return sum(1 << place for i, place in enumerate(at) if number >> i & 1)
