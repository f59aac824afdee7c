"""Faults of the wire: what becomes of an answer on its way."""

import asyncio
from collections.abc import Callable, Sequence

Spoil = Callable[[int, bytes], Sequence[tuple[float, bytes]]]
"""Takes who answers (unit or node) and the whole frame; gives what is heard instead, each after so many seconds."""


def send(write: Callable[[bytes], None], spoil: Spoil | None, sender: int, frame: bytes) -> None:
    """Write the frame, or what the fault makes of it; late pieces come when the event loop's time has passed."""
    for delay_s, heard in ((0.0, frame),) if spoil is None else spoil(sender, frame):
        if delay_s > 0:
            asyncio.get_running_loop().call_later(delay_s, write, heard)
        else:
            write(heard)
