"""Faults of the wire: how answers are changed on their way."""

import asyncio
from collections.abc import Callable, Sequence

Spoil = Callable[[int, bytes], Sequence[tuple[float, bytes]]]
"""Takes the sender (unit or node) and the whole frame; returns the frames received instead, each with a delay in s."""


def send(write: Callable[[bytes], None], spoil: Spoil | None, sender: int, frame: bytes) -> None:
    """Write the frame, or what the fault makes of it; late pieces follow on the event loop's time."""
    for delay_s, heard in ((0.0, frame),) if spoil is None else spoil(sender, frame):
        if delay_s > 0:
            asyncio.get_running_loop().call_later(delay_s, write, heard)
        else:
            write(heard)
